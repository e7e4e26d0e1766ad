"""A suite as one self-contained HTML page: curves, tables, links to its runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from typing import Any

import jinja2

from simbench.metric_names import COVERAGES, find_metric
from simbench.report.page import indices
from simbench.report.plots import Plot
from simbench.report.suite_ladder import ladder_table
from simbench.report.suite_plots import curve_plots
from simbench.report.table import NONE, ErrorTable, shown_number

# What measured_meaning gives: (title, unit).
MEANINGS: Mapping[str, tuple[str, str]] = {
    "corners_per_mp": ("corners", "per megapixel"),
    "edges_px_per_mp": ("edge length", "px per megapixel"),
    "deviation_cm": ("deviation from rigid", "cm RMS"),
}
_CHANGES = 1.15      # a meaning that changes by less over a dial is not the dial's


def render_suite(results: Mapping[str, Any], timing: Mapping[str, Mapping[str, Any]],
                 with_report: Iterable[str]) -> str:
    """The page of a suite's results.

    Args:
        results: as results.json.
        timing: the `timing` of each run, by the run's key.
        with_report: the keys of the runs that have a report.html of their own.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("simbench.report", "templates"),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["indices"] = indices
    suite, runs = results["suite"], results["runs"]
    reports = set(with_report)
    return environment.get_template("suite.html.j2").render(
        suite=suite, tiles=_tiles(suite, runs),
        cases=[_case(case["name"], results, reports) for case in suite["cases"]],
        trouble=[(_title(run), run.get("reason", ""), run["folder"]) for run in runs
                 if run["status"] != "done"],
        speed=_speed_table(suite, runs, timing), versions=results["versions"],
        version=metadata.version("simbench-slam"))


def _tiles(suite: Mapping[str, Any], runs: Sequence[Mapping[str, Any]]
           ) -> list[tuple[str, str, str]]:
    lost = sum(run["status"] != "done" for run in runs)
    frames = sum(run.get("frames", 0) for run in runs)
    lost_frames = sum(run.get("lost_frames", 0) for run in runs)
    return [("Runs", str(len(runs)), ""), ("Runs lost or failed", str(lost), f"of {len(runs)}"),
            ("Frames without pose", str(lost_frames), f"of {frames}"),
            ("Seeds", str(len(suite["seeds"])), ""), ("Systems", str(len(suite["systems"])), "")]


def _case(name: str, results: Mapping[str, Any], reports: set[str]) -> dict[str, Any]:
    suite = results["suite"]
    case = next(case for case in suite["cases"] if case["name"] == name)
    here = {key: [each for each in results[key] if each["case"] == name]
            for key in ("summary", "meaning", "against_first", "runs")}
    table = ladder_table(here["runs"], suite["metrics"], suite["systems"],
                         results["no_objects_from"])
    return {"name": name, "what": _what(case), "plots": _plots(case, here, suite),
            "table": _error_table(here["summary"], results),
            "meaning": _meaning_table(here["meaning"]),
            "pairs": _pair_table(here["against_first"], results["resolution"]),
            "ladder": table,
            "runs": [(_title(run), run["folder"] + ("/report.html" if run["key"] in reports else
                                                    "/metrics.json" if "metrics" in run else
                                                    "/log.txt"), run["status"])
                     for run in here["runs"]]}


def _what(case: Mapping[str, Any]) -> str:
    words = [case.get("scene") or case.get("folder", "")]
    if "size" in case:
        words.append(f"{case['size'][0]}×{case['size'][1]}")
    if "frames" in case:
        words.append(f"{case['frames']} frames")
    fixed = {**case.get("dials", {}), **case.get("inputs", {}), **case.get("sensor_settings", {})}
    words += [f"{key} {value}" for key, value in fixed.items()]
    return ", ".join(words)


def _plots(case: Mapping[str, Any], here: Mapping[str, Any], suite: Mapping[str, Any]
           ) -> list[Plot]:
    sweep = case.get("sweep", [])
    dials = [name for name, values in sweep if len(values) > 1
             and all(not isinstance(v, str) for v in values)]
    if not dials:
        return []
    dial = dials[0]
    plots = []
    for also in _others(here["summary"], dial):
        fits = [s for s in here["summary"] if _without(s["point"], dial) == also]
        meaning = [m for m in here["meaning"] if _without(m["point"], dial) == also]
        plots += curve_plots(fits, meaning, dial, (*suite["metrics"], *COVERAGES),
                             suite["systems"], also, _most_telling(meaning))
    return plots


def _others(summary: Iterable[Mapping[str, Any]], dial: str) -> list[dict[str, Any]]:
    """What else is swept: every combination once, in order."""
    found: list[dict[str, Any]] = []
    for each in summary:
        rest = _without(each["point"], dial)
        if rest not in found:
            found.append(rest)
    return found


def _without(point: Mapping[str, Any], dial: str) -> dict[str, Any]:
    return {name: value for name, value in point.items() if name != dial}


def _changing(meaning: Sequence[Mapping[str, Any]]) -> list[tuple[float, str]]:
    """(how many times it grows, key) of each measured meaning that changes over the points."""
    found = []
    for key in MEANINGS:
        values = [m[key] for m in meaning if key in m]
        if values and max(values) > 0:
            ratio = max(values) / max(min(values), 1e-3 * max(values))
            if ratio > _CHANGES:
                found.append((ratio, key))
    return sorted(found, reverse=True)


def _most_telling(meaning: Sequence[Mapping[str, Any]]) -> tuple[str, str, str] | None:
    changing = _changing(meaning)
    return (changing[0][1], *MEANINGS[changing[0][1]]) if changing else None


def _error_table(summary: Sequence[Mapping[str, Any]], results: Mapping[str, Any]) -> ErrorTable:
    metrics, resolution = results["suite"]["metrics"], results["resolution"]
    names = [name for name in dict.fromkeys((*metrics, *COVERAGES))
             if any(name in s["metrics"] for s in summary)]
    columns = ["", *(_heading(name) for name in names), "lost frames", "lost runs",
               f"seeds for {100 * resolution:g} %"]
    rows = []
    for each in summary:
        cells = [shown_interval(each["metrics"].get(name), find_metric(name).unit)
                 for name in names]
        first = each["metrics"].get(metrics[0], {})
        needed = first.get("seeds_needed")
        rows.append((_row_head(each), *cells,
                     f"{each['lost_frames']} of {each['frames']}",
                     f"{each['lost_runs']} of {each['runs']}",
                     NONE if needed is None else str(needed)))
    return ErrorTable(tuple(columns), tuple(rows), (
        *_note_on_objects(results["no_objects_from"], names),
        f"Means over the seeds with 95 % intervals by bootstrap. “Seeds for "
        f"{100 * resolution:g} %”: how many would make the mean of {metrics[0]} known to "
        f"± {100 * resolution:g} %, by the spread seen here; pairs need fewer.",))


def _note_on_objects(silent: Sequence[str], metrics: Iterable[str]) -> Iterator[str]:
    if silent and any(name.startswith("objects") for name in metrics):
        yield (f"{', '.join(silent)}: no motion of an object in any run of the suite, so that "
               "nothing of objects is told; a system that loses all of them has coverage 0.")


def summary_table(results: Mapping[str, Any]) -> ErrorTable:
    """All cases, points and systems in one table, for the terminal."""
    summary = results["summary"]
    table = _error_table(summary, results)
    rows = tuple((f"{each['case']}, {row[0]}", *row[1:])
                 for each, row in zip(summary, table.rows, strict=True))
    return ErrorTable(table.columns, rows, table.notes)


def _heading(name: str) -> str:
    unit = find_metric(name).unit
    return f"{name} ({'mm' if unit == 'm' else unit})" if unit else name


def shown_interval(block: Mapping[str, Any] | None, unit: str) -> str:
    """"1.23 [1.10, 1.40]", metres in mm; one value alone says so."""
    if block is None:
        return NONE
    scale = 1e3 if unit == "m" else 1.0
    if block["low"] is None:
        return f"{shown_number(block['mean'], scale)} (1 seed)"
    return (f"{shown_number(block['mean'], scale)} "
            f"[{shown_number(block['low'], scale)}, {shown_number(block['high'], scale)}]")


def _meaning_table(meaning: Sequence[Mapping[str, Any]]) -> ErrorTable | None:
    changing = {key for _, key in _changing(meaning)}
    keys = [key for key in MEANINGS if key in changing]
    if not keys:
        return None
    rows = tuple((_point(m["point"]), *(shown_number(m.get(key)) for key in keys))
                 for m in meaning)
    return ErrorTable(("", *(f"{MEANINGS[k][0]} ({MEANINGS[k][1]})" for k in keys)), rows, ())


def _pair_table(pairs: Sequence[Mapping[str, Any]], resolution: float) -> ErrorTable | None:
    if not pairs:
        return None
    rows = []
    for each in pairs:
        scale, unit = (100.0, " %") if each["relative"] else (1.0, "")
        interval = "" if each["low"] is None else \
            f" [{scale * each['low']:+.3g}, {scale * each['high']:+.3g}]"
        rows.append((_row_head(each), each["metric"],
                     f"{scale * each['mean']:+.3g}{unit}{interval}", str(each["n"]),
                     str(each.get("seeds_needed") or NONE)))
    wanted = f"{100 * resolution:g} %"
    return ErrorTable(("", "metric", f"worse than {pairs[0]['first']} by", "pairs",
                       f"pairs for {wanted}"), tuple(rows), (
        "Each pair is one seed's sequence, seen by both; negative is better. Where the interval "
        f"does not hold 0, the two differ. “Pairs for {wanted}”: how many seeds would make this "
        f"difference known to ± {wanted}, by the spread seen here.",))


def _speed_table(suite: Mapping[str, Any], runs: Sequence[Mapping[str, Any]],
                 timing: Mapping[str, Mapping[str, Any]]) -> ErrorTable | None:
    rows = []
    for system in suite["systems"]:
        ms = sorted(timing[run["key"]]["ms_per_frame_median"] for run in runs
                    if run["system"] == system
                    and "ms_per_frame_median" in timing.get(run["key"], {}))
        if ms:
            rows.append((system, f"{ms[len(ms) // 2]:.1f}", f"{ms[0]:.1f} to {ms[-1]:.1f}"))
    return ErrorTable(("", "median frame (ms)", "over the runs"), tuple(rows), (
        "Inside the system, while other workers took their share of the machine.",)) \
        if rows else None


def _point(point: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" if isinstance(value, str) else f"{name} {value:g}"
                     for name, value in point.items())


def _row_head(each: Mapping[str, Any]) -> str:
    return ", ".join(part for part in (_point(each["point"]), each["system"]) if part)


def _title(run: Mapping[str, Any]) -> str:
    return ", ".join(part for part in (run["case"], _point(run["point"]), run["system"],
                                       f"seed {run['seed']}") if part)
