"""The result of a suite: its runs, what each dial measured, and means over seeds with intervals."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from simbench.metric_names import COVERAGES, METRICS, Metric
from simbench.statistics import mean_interval, seeds_needed
from simbench.suites.jobs import Run
from simbench.suites.spec import Suite
from simbench.versions import versions

SCHEMA = 1
RESOLUTION = 0.05    # of a mean; for which the number of seeds is told if none is asked for


def results_of(suite: Suite, runs: Sequence[Run], found: Mapping[str, Mapping[str, Any]],
               resolution: float = RESOLUTION) -> dict[str, Any]:
    """results.json: equal runs give equal bytes, so nothing of time is in it.

    Args:
        found: what SuiteFolder keeps of each run, by its key.
        resolution: the share of a mean for which the number of seeds is told.
    """
    records = [dict(found[run.key]["record"]) for run in runs]
    silent = systems_without_objects(records)
    stated = [without_objects(record) if record["system"] in silent else record
              for record in records]
    return {"schema": SCHEMA, "suite": suite.as_json(), "versions": versions(), "runs": records,
            "no_objects_from": silent, "meaning": _meanings(runs, found),
            "resolution": resolution, "summary": _summaries(suite, stated, resolution),
            "against_first": _against_first(suite, stated, resolution)}


def systems_without_objects(records: Iterable[Mapping[str, Any]]) -> list[str]:
    """The systems that gave a motion of an object in none of these runs, right or wrong.

    They estimate the camera alone, as far as anybody can tell: no share of the objects' motions is
    theirs. A system that loses all objects of some runs is known by the others.
    """
    spoke: dict[str, bool] = {}
    for record in records:
        metrics = record.get("metrics", {})
        spoke[record["system"]] = spoke.get(record["system"], False) or any(
            metrics.get(f"{block}.{name}", 0) > 0 for block in ("objects", "objects_batch")
            for name in ("mean.frames", "all.coverage", "mean.false_motions",
                         "mean.tracks_without_object"))
    return sorted(system for system, any_motion in spoke.items() if not any_motion)


def without_objects(record: Mapping[str, Any]) -> dict[str, Any]:
    """A run's record without what is said of objects."""
    kept = {name: value for name, value in record.get("metrics", {}).items()
            if not name.startswith("objects")}
    return {**record, "metrics": kept}


def _meanings(runs: Sequence[Run], found: Mapping[str, Mapping[str, Any]]
              ) -> list[dict[str, Any]]:
    """What the pictures and objects of each case and point measured, means over the seeds."""
    at: dict[tuple[str, str], tuple[Run, dict[int, Mapping[str, float]]]] = {}
    for run in runs:
        if found[run.key]["meaning"]:
            _, by_seed = at.setdefault((run.case, repr(run.point)), (run, {}))
            by_seed[run.seed] = found[run.key]["meaning"]
    out = []
    for run, by_seed in at.values():
        names = sorted(set.intersection(*(set(m) for m in by_seed.values())))
        out.append({"case": run.case, "point": dict(run.point),
                    **{name: float(np.mean([m[name] for m in by_seed.values()]))
                       for name in names}})
    return out


def _summaries(suite: Suite, records: Iterable[Mapping[str, Any]], resolution: float
               ) -> list[dict[str, Any]]:
    """One for each case, point and system: how many runs came through, and every metric shown."""
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for record in records:
        groups.setdefault(_cell(record), []).append(record)
    return [_summary(group, (*suite.metrics, *COVERAGES), resolution)
            for group in groups.values()]


def _cell(record: Mapping[str, Any]) -> tuple[str, str, str]:
    return str(record["case"]), repr(record["point"]), str(record["system"])


def _summary(group: list[Mapping[str, Any]], metrics: Iterable[str], resolution: float
             ) -> dict[str, Any]:
    first = group[0]
    out = {"case": first["case"], "point": first["point"], "system": first["system"],
           "runs": len(group),
           "lost_runs": sum(record["status"] != "done" for record in group),
           "frames": sum(record.get("frames", 0) for record in group),
           "lost_frames": sum(record.get("lost_frames", 0) for record in group), "metrics": {}}
    for name in dict.fromkeys(metrics):
        values = [record["metrics"][name] for record in group
                  if name in record.get("metrics", {})]
        if values:
            out["metrics"][name] = interval_json(values) \
                | {"seeds_needed": _seeds_for(values, resolution)}
    return out


def interval_json(values: Sequence[float]) -> dict[str, Any]:
    """Mean, interval and number of the values; one value has no interval."""
    found = mean_interval(values)
    return {"mean": found.mean, "low": found.low, "high": found.high, "n": found.n}


def _seeds_for(values: Sequence[float], resolution: float) -> int | None:
    mean = abs(float(np.mean(values)))
    return seeds_needed(values, resolution * mean) if mean > 0 else None


def _against_first(suite: Suite, records: Sequence[Mapping[str, Any]], resolution: float
                   ) -> list[dict[str, Any]]:
    """Each other system against the first, on equal sequences: the mean change for the worse."""
    first = suite.systems[0]
    base = {(r["case"], repr(r["point"]), r["seed"]): r for r in records if r["system"] == first}
    pairs: dict[tuple[str, str, str, str], list[tuple[float, float]]] = {}
    points: dict[str, Any] = {}
    for record in records:
        other = base.get((record["case"], repr(record["point"]), record["seed"]))
        if record["system"] == first or other is None:
            continue
        points[repr(record["point"])] = record["point"]
        for name in suite.metrics:
            if name in record.get("metrics", {}) and name in other.get("metrics", {}):
                pairs.setdefault((*_cell(record), name), []).append(
                    (other["metrics"][name], record["metrics"][name]))
    return [{"case": case, "point": points[point], "system": system, "first": first,
             "metric": name, **_paired(METRICS[name], values, resolution)}
            for (case, point, system, name), values in pairs.items()]


def _paired(metric: Metric, values: Sequence[tuple[float, float]], resolution: float
            ) -> dict[str, Any]:
    """The mean change for the worse; how many pairs would tell a relative one of `resolution`."""
    changes = [metric.worsening(old, new) for old, new in values]
    out = {"relative": metric.relative, **interval_json(changes)}
    return out | ({"seeds_needed": seeds_needed(changes, resolution)} if metric.relative else {})


def results_csv(results: Mapping[str, Any]) -> str:
    """One row for each run: what it is, what became of it, all its metrics."""
    runs = results["runs"]
    swept = list(dict.fromkeys(name for run in runs for name in run["point"]))
    names = sorted({name for run in runs for name in run.get("metrics", {})})
    head = ["case", "system", "seed", "status", "frames", "lost_frames"]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*head[:2], *swept, *head[2:], *names])
    for run in runs:
        writer.writerow([run["case"], run["system"],
                         *(run["point"].get(name, "") for name in swept),
                         *(run.get(name, "") for name in head[2:]),
                         *(repr(run["metrics"][name]) if name in run.get("metrics", {}) else ""
                           for name in names)])
    return out.getvalue()
