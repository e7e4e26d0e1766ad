"""A suite from its description to its results."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from simbench.detections import load_detector
from simbench.errors import UserError
from simbench.inputs import Feed
from simbench.load_system import load_system
from simbench.program import PREFIX, UNLIMITED, Limits, words_of
from simbench.report.suite_page import render_suite
from simbench.sequence import open_sequence
from simbench.storage import write_bytes, write_json
from simbench.suites.cache import SequenceCache
from simbench.suites.folder import SuiteFolder
from simbench.suites.jobs import Run, Task, runs_of, tasks_of
from simbench.suites.pool import Opener, dask_workers, local_workers, perform_all
from simbench.suites.results import RESOLUTION, results_csv, results_of
from simbench.suites.spec import Suite
from simbench.suites.stage import generate_settings
from simbench.suites.work import HowToWork, TaskResult
from slam.types import Intrinsics

_SOME_CAMERA = Intrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)


@dataclass(frozen=True, slots=True)
class Where:
    """How a suite is worked off."""

    workers: int | None = None      # processes; all processors by default
    dask: str = ""                  # the address of a scheduler, instead
    cache: str = ""                 # folder or URL of rendered sequences
    reports: str = "first"          # which runs get a report.html: first seeds, all, none
    limits: Limits = UNLIMITED

    def check_cache(self) -> None:
        """Raises UserError or OSError where the cache cannot be used: before a suite begins.

        A cluster's workers may have folders where we have none.
        """
        if self.cache and not self.dask:
            SequenceCache(self.cache).check_writable()

    def opener(self) -> Opener:
        """What opens the workers."""
        if self.dask:
            return partial(dask_workers, self.dask)
        return partial(local_workers, self.workers or os.cpu_count() or 1)


def run_suite(suite: Suite, out: Path, where: Where, *, resume: bool = False,
              resolution: float = RESOLUTION,
              on_run: Callable[[int], None] = lambda done: None) -> dict[str, Any]:
    """Do all runs of a suite that are not done yet, and write its results.

    Args:
        resolution: the share of a mean for which the number of seeds is told.
        on_run: called with the number of runs that are done, whenever that grows.
    Returns:
        results.json.
    Raises:
        UserError: an unknown scene, recording, detector, dial, system or input, or the folder is
            something else's.
        OSError: the folder or the cache cannot be written.
    """
    check_names(suite)
    if not where.dask:      # a cluster's workers may have files where we have none
        check_files(suite)
    where.check_cache()
    folder = SuiteFolder(out)
    runs = runs_of(suite)
    folder.claim(suite, runs, resume)
    found = finished(runs, folder, where, on_run)
    results = results_of(suite, runs, found, resolution)
    write_json(out / "timing.json", {run.folder: found[run.key]["timing"] for run in runs})
    write_bytes(out / "results.csv", results_csv(results).encode())
    write_bytes(out / "report.html", render_suite(
        results, {run.key: found[run.key]["timing"] for run in runs},
        {run.key for run in runs if (out / run.folder / "report.html").is_file()}).encode())
    write_json(out / "results.json", results)
    return results


def finished(runs: list[Run], folder: SuiteFolder, where: Where,
             on_run: Callable[[int], None]) -> dict[str, Mapping[str, Any]]:
    """What is kept of every run, by its key; those that are not done yet are done now."""
    found: dict[str, Mapping[str, Any]] = {}
    for run in runs:
        record = folder.record_of(run)
        if record is not None and record["record"].get("status") != "failed":
            found[run.key] = record
    on_run(len(found))

    def keep(task: Task, result: TaskResult) -> None:
        folder.keep(task, result)
        for each in result.runs:
            found[each.key] = {"record": each.record, "timing": each.timing,
                               "meaning": result.meaning}
        on_run(len(found))

    missing = [run for run in runs if run.key not in found]
    how = HowToWork(where.cache, _with_report(runs, where.reports), where.limits)
    if missing:
        perform_all(tasks_of(missing), how, where.opener(), keep)
    return found


def _with_report(runs: list[Run], which: str) -> frozenset[str]:
    if which == "first":
        first = min((run.seed for run in runs), default=0)
        return frozenset(run.key for run in runs if run.seed == first)
    return frozenset(run.key for run in runs) if which == "all" else frozenset()


def check_files(suite: Suite) -> None:
    """Raises UserError where a case names a folder that is no sequence, or lacks what it wants, or
    a detector that cannot be loaded."""
    for case in suite.cases:
        choices = [case.at(point).choice() for point in case.points()]
        try:
            if case.folder:
                sequence = open_sequence(case.folder, case.calibration or None)
                for choice in choices:
                    Feed(sequence, choice)
            for detector in {choice.detector for choice in choices} - {None}:
                load_detector(str(detector))
        except UserError as error:
            raise UserError(f"case {case.name}: {error}") from None


def check_names(suite: Suite) -> None:
    """Raises UserError where a run could only fail: no such scene, dial, system or setting, or
    more than can be drawn."""
    for case, point in suite.cells():
        here = case.at(point)
        if not here.scene:
            continue
        try:
            generate_settings(here.sequence(suite.seeds[0]), "ideal")
        except UserError as error:
            raise UserError(f"case {case.name}: {error}") from None
    settings = {case.at(point).settings for case, point in suite.cells()}
    for system in suite.systems:
        if system.startswith(PREFIX):
            words_of(system)
            continue
        for each in settings:
            load_system(system, _SOME_CAMERA, each)
