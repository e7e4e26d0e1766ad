"""What a worker does with a task. It writes nothing but its own scratch folder: the files of each
run are handed back, so that a worker may be any process on any machine."""

from __future__ import annotations

import os
import tempfile
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from simbench.errors import UserError
from simbench.inputs import Feed
from simbench.metric_names import flat_metrics
from simbench.outcome import Outcome
from simbench.program import PREFIX, UNLIMITED, Limits, run_program
from simbench.remote import local_folder
from simbench.run_to_folder import run_to_folder
from simbench.sensors.spec import find_sensor
from simbench.sequence import Sequence, open_sequence
from simbench.suites.cache import SequenceCache, scratch_folder
from simbench.suites.jobs import Run, Task
from simbench.suites.meaning import measured_meaning
from simbench.suites.spec import SequenceSpec
from simbench.suites.stage import generate_settings, opened

DONE, LOST, FAILED = "done", "lost", "failed"
_FILES = ("trajectory.txt", "object_motions.txt", "objects.txt", "report.html", "config.yaml",
          "log.txt", "metrics.json")


@dataclass(frozen=True, slots=True)
class HowToWork:
    """What is the same for all tasks of a suite."""

    cache: str = ""                 # path or URL; "" for none
    reports: frozenset[str] = frozenset()       # keys of the runs that get a report.html
    limits: Limits = UNLIMITED      # of external programs


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run as it is handed back."""

    key: str
    status: str                     # done, lost (followed no frame), failed (no run at all)
    reason: str                     # of lost and failed, in one line
    again: bool                     # failed in a way that a second try may mend
    record: dict[str, Any]          # what of it goes into results.json
    timing: dict[str, Any]
    files: dict[str, bytes]         # by name


@dataclass(frozen=True, slots=True)
class TaskResult:
    """The runs of a task, and what its sequence measures."""

    runs: tuple[RunResult, ...]
    meaning: dict[str, float]


def perform(task: Task, how: HowToWork) -> TaskResult:
    """Do all runs of a task. What goes wrong in one run is that run's result."""
    cache = SequenceCache(how.cache) if how.cache else None
    ours = [run for run in task.runs if not run.system.startswith(PREFIX)]
    results: dict[str, RunResult] = {}
    meaning: dict[str, float] = {}
    blurred = any(find_sensor(run.choice.sensor or "ideal").exposure_s > 0 for run in ours)
    with opened(task.sequence, len(ours), cache, blurred) as sequence:
        meaning = measured_meaning(sequence)
        for run in ours:
            results[run.key] = _guarded(run, partial(_run_ours, run, sequence,
                                                     run.key in how.reports))
    for run in task.runs:
        if run.key not in results:
            results[run.key] = _guarded(run, partial(_run_program, run, cache, how.limits))
    return TaskResult(tuple(results[run.key] for run in task.runs), meaning)


def _guarded(run: Run, work: Callable[[Path], Outcome]) -> RunResult:
    try:
        with tempfile.TemporaryDirectory(prefix="simbench-run-") as scratch:
            out = Path(scratch) / "run"
            return _result(run, work(out), out)
    except UserError as error:
        return failed(run, str(error), again=False)
    except Exception as error:
        return failed(run, f"{type(error).__name__}: {error}", again=True,
                      log=traceback.format_exc())


def _run_ours(run: Run, sequence: Sequence, report: bool, out: Path) -> Outcome:
    feed = Feed(sequence, run.choice, run.seed, run.sequence.frames)
    return run_to_folder(run.system, feed, out, settings=run.settings, report=report,
                         command={"case": run.case, "point": dict(run.point),
                                  "source": run.sequence.scene or run.sequence.folder,
                                  "size": run.sequence.size, "fps": run.sequence.fps,
                                  "dials": dict(run.sequence.dials)})


def _run_program(run: Run, cache: SequenceCache | None, limits: Limits, out: Path) -> Outcome:
    """A program reads a folder: a recording's own, or one rendered with the run's sensor."""
    spec = run.sequence
    with _folder_for(spec, run.choice.sensor or "ideal", cache) as place:
        sequence = open_sequence(place, spec.calibration or None)
        return run_program(run.system, sequence, place, out, limits)


def _folder_for(spec: SequenceSpec, sensor: str, cache: SequenceCache | None
                ) -> AbstractContextManager[Path]:
    if spec.folder:
        return nullcontext(local_folder(spec.folder))
    settings = generate_settings(spec, sensor)
    return cache.folder_of(settings) if cache else scratch_folder(settings)


def _result(run: Run, outcome: Outcome, out: Path) -> RunResult:
    metrics = dict(outcome.metrics)
    record = _head(run) | {
        "frames": outcome.frames, "lost_frames": outcome.lost,
        "sequence": metrics["sequence"], "metrics": flat_metrics(metrics)}
    files = {name: (out / name).read_bytes() for name in _FILES if (out / name).is_file()}
    reason = " ".join(outcome.failure.split())
    record |= {"status": LOST if reason else DONE} | ({"reason": reason} if reason else {})
    return RunResult(run.key, str(record["status"]), reason, False, record,
                     metrics.get("timing", {}), files)


def failed(run: Run, reason: str, *, again: bool, log: str = "") -> RunResult:
    """The result of a run that could not be done."""
    reason = " ".join(reason.split())
    record = _head(run) | {"status": FAILED, "reason": reason}
    return RunResult(run.key, FAILED, reason, again, record, {},
                     {"log.txt": (log or reason + "\n").encode()})


def _head(run: Run) -> dict[str, Any]:
    return {"key": run.key, "case": run.case, "point": dict(run.point), "system": run.system,
            "seed": run.seed, "folder": run.folder, "asked": asked_of(run)}


def asked_of(run: Run) -> dict[str, Any]:
    """What the system was asked to do, as a gate compares it: scene, dials, frames, inputs."""
    spec = run.sequence
    asked = {"scene": spec.scene, "folder": Path(spec.folder).name, "dials": dict(spec.dials),
             "frames": spec.frames, "size": list(spec.size or ()), "fps": spec.fps,
             "settings": list(run.settings)}
    asked |= {f"input {key}": value for key, value in asdict(run.choice).items()}
    return {key: value for key, value in asked.items() if value not in (None, "", {}, [])}


def start_worker(threads: int) -> None:
    """What a worker process does first: takes its share of the processors, dies with its parent.

    From here on it hears Ctrl-C, so that a program it runs is ended, too.
    """
    import signal  # noqa: PLC0415
    import threading  # noqa: PLC0415
    from multiprocessing import parent_process  # noqa: PLC0415

    import cv2  # noqa: PLC0415
    import numba  # noqa: PLC0415

    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["LP_NUM_THREADS"] = str(threads)   # Mesa's software rasteriser takes all otherwise
    cv2.setNumThreads(threads)
    numba.set_num_threads(min(threads, numba.get_num_threads()))

    def follow_parent() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow_parent, daemon=True).start()
