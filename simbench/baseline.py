"""A baseline: what a run or a suite gave when somebody said that it was right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simbench.errors import BadFile, UnknownName, UserError
from simbench.metric_names import COVERAGES, SHOWN, Metric, find_metric, flat_metrics
from simbench.run_folder import read_metrics
from simbench.stated import MOST_SEED, items, mapping, not_negative, text, whole
from simbench.storage import write_json
from simbench.untrusted import read_json_object, read_yaml
from simbench.versions import versions

SCHEMA = 1
_MOST_BYTES = 50_000_000
_ASKED_OF_A_RUN = ("source", "dials", "frames", "size", "fps", "inputs")


@dataclass(frozen=True, slots=True)
class BlessedRun:
    """One run: what was asked for, what bytes the system was given, what came out."""

    case: str
    point: Mapping[str, Any]
    system: str
    seed: int
    asked: Mapping[str, Any]
    status: str
    given_sha256: str
    values: Mapping[str, float]

    @property
    def cell(self) -> tuple[str, str, str]:
        """Runs of one cell differ by their seed only."""
        return self.case, repr(sorted(self.point.items())), self.system


@dataclass(frozen=True, slots=True)
class Baseline:
    """The runs, and the metrics that are guarded, with what change of each is none."""

    name: str
    metrics: tuple[Metric, ...]
    runs: tuple[BlessedRun, ...]


def bless(place: Path, baseline: Path) -> Baseline:
    """Write the baseline of a run's or a suite's folder; returns it.

    Raises:
        BadFile: no finished run or suite is there.
        UserError: a run of it failed or nothing was measured, so that there is nothing to hold
            others against.
        OSError: the file cannot be written.
    """
    found = outcome_of(place)
    bad = [run for run in found.runs if run.status != "done"]
    if bad:
        raise UserError(f"{place}: {len(bad)} of {len(found.runs)} runs were lost or failed, first "
                        f"{bad[0].case} {bad[0].system} seed {bad[0].seed}; mend them before "
                        "blessing")
    if not any(run.values for run in found.runs):
        raise UserError(f"{place}: none of {', '.join(m.name for m in found.metrics)} was "
                        "measured: there is nothing to hold others against; run more frames")
    baseline.parent.mkdir(parents=True, exist_ok=True)
    write_json(baseline, {
        "schema": SCHEMA, "name": found.name, "versions": versions(),
        "metrics": {m.name: {"unit": m.unit, "better": m.better, "relative": m.relative,
                             "tolerance": m.tolerance} for m in found.metrics},
        "runs": [{"case": run.case, "point": dict(run.point), "system": run.system,
                  "seed": run.seed, "asked": dict(run.asked), "status": run.status,
                  "given_sha256": run.given_sha256, "values": dict(run.values)}
                 for run in found.runs]})
    return found


def outcome_of(place: Path) -> Baseline:
    """What a run's or a suite's folder holds, as a baseline would. Raises BadFile."""
    if (place / "results.json").is_file():
        return _of_suite(place)
    if (place / "suite.json").is_file():
        raise BadFile(f"{place}: this suite is not finished; finish it with --resume")
    if not place.is_dir():
        raise BadFile(f"{place}: no such folder; give the folder of a run or a suite")
    if not (place / "metrics.json").is_file():
        raise BadFile(f"{place}: holds neither a run nor a suite (metrics.json, results.json); "
                      "give the folder that one of them was written to")
    return _of_run(place)


def read_baseline(path: Path) -> Baseline:
    """A baseline from its file.

    Raises:
        BadFile: it is missing, or not a baseline of this schema; the message says where.
    """
    value = read_json_object(path, "write one with `simbench bless RUN_OR_SUITE --baseline FILE`",
                             _MOST_BYTES)
    if value.get("schema") != SCHEMA:
        raise BadFile(f"{path}: schema is {value.get('schema')!r}, wanted {SCHEMA}; bless it again")
    try:
        metrics = tuple(_metric(name, stated)
                        for name, stated in mapping(value["metrics"], "metrics").items())
        runs = tuple(_run(run) for run in items(value["runs"], "runs"))
        if len({(*run.cell, run.seed) for run in runs}) < max(len(runs), 1):
            raise ValueError("runs: none, or one stands there twice")
        return Baseline(text(value["name"], "name"), metrics, runs)
    except KeyError as error:
        raise BadFile(f"{path}: not a baseline ({error} is missing); bless it again") from None
    except (TypeError, AttributeError, ValueError) as error:
        raise BadFile(f"{path}: not a baseline ({error}); bless it again") from None
    except UnknownName as error:
        raise BadFile(f"{path}: {error}") from None


def _metric(name: str, stated: Any) -> Metric:
    known, value = find_metric(name), mapping(stated, name)
    better = text(value["better"], f"better of {name}")
    if better not in ("lower", "higher"):
        raise ValueError(f"better of {name} is {better!r:.40}, wanted lower or higher")
    tolerance = not_negative(value["tolerance"], f"tolerance of {name}")
    return Metric(name, known.unit, better, tolerance, bool(value["relative"]),
                  known.floor, known.help)


def _run(value: Mapping[str, Any]) -> BlessedRun:
    return BlessedRun(
        text(value["case"], "case"), mapping(value["point"], "point"),
        text(value["system"], "system"), whole(value["seed"], "seed", 0, MOST_SEED),
        mapping(value["asked"], "asked"), text(value["status"], "status"),
        text(value["given_sha256"], "given_sha256"),
        {name: not_negative(found, f"{name:.40}")
         for name, found in mapping(value["values"], "values").items()})


def _of_suite(place: Path) -> Baseline:
    path = place / "results.json"
    results = read_json_object(path, "run the suite again", _MOST_BYTES)
    try:
        suite = results["suite"]
        metrics = tuple(find_metric(name) for name in dict.fromkeys((*suite["metrics"],
                                                                     *COVERAGES)))
        runs = tuple(_of_record(run, metrics) for run in results["runs"])
        return Baseline(f"{suite['name']} version {suite['version']}", metrics, runs)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BadFile(f"{path}: not the results of a suite ({type(error).__name__}: {error}); run "
                      "it again") from None


def _of_record(run: Mapping[str, Any], metrics: Sequence[Metric]) -> BlessedRun:
    found = _blessed(run["case"], run["point"], run["system"], run["seed"], run["asked"],
                     run["status"], mapping(run.get("sequence", {}), "sequence"),
                     mapping(run.get("metrics", {}), "metrics"), metrics)
    return _run(asdict(found))


def _of_run(place: Path) -> Baseline:
    metrics = tuple(find_metric(name) for name in (*SHOWN, *COVERAGES))
    found = read_metrics(place)
    try:
        config = read_yaml(place / "config.yaml", "run it again")
        asked = {key: config[key] for key in _ASKED_OF_A_RUN if config.get(key)}
        name = str(found["sequence"]["name"])
        if "/" in str(asked.get("source", "")):
            asked["source"] = name      # a folder may lie elsewhere
        status = "done" if found.get("camera", {}).get("coverage") else "lost"
        seed = whole(config.get("seed", 0), "seed", 0, MOST_SEED)
        run = _blessed(name, {}, str(found["system"]), seed, asked, status, found["sequence"],
                       flat_metrics(found), metrics)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BadFile(f"{place}: not a run of this version ({type(error).__name__}); run it again"
                      ) from None
    return Baseline(name, metrics, (run,))


def _blessed(case: str, point: Mapping[str, Any], system: str, seed: int,
             asked: Mapping[str, Any], status: str, sequence: Mapping[str, Any],
             values: Mapping[str, float], metrics: Sequence[Metric]) -> BlessedRun:
    given = sequence.get("given_sha256") or sequence.get("sha256", "")
    return BlessedRun(case, point, system, seed, asked, status, str(given),
                      {m.name: values[m.name] for m in metrics if m.name in values})
