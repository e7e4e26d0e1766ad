"""The breaking point search from the command to its folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from simbench.report.suite_page import render_suite
from simbench.storage import write_bytes, write_json
from simbench.suites.breaking import (
    DEFAULT_STEPS,
    Limit,
    as_json,
    ends_of,
    search,
    swept,
)
from simbench.suites.folder import SuiteFolder
from simbench.suites.jobs import Run, runs_of
from simbench.suites.results import results_csv, results_of
from simbench.suites.run_suite import Where, check_names, finished
from simbench.suites.spec import Suite
from slam.geometry.arrays import Array


def run_break(suite: Suite, dial: str, limit: Limit, out: Path, where: Where, *,
              start: float | None = None, end: float | None = None, steps: int = DEFAULT_STEPS,
              resume: bool = False, on_run: Callable[[int], None] = lambda done: None
              ) -> list[Mapping[str, Any]]:
    """Search the breaking point of every system of a suite with one case.

    What the case sweeps has one value each: the dials that are held during the search. So they
    stand in the path and the key of every run, and searches with others share no run.
    Writes what a suite writes, and breaking.json; returns what is in that.

    Raises:
        UserError: an unknown dial, system or input, or the folder is something else's.
        OSError: the folder cannot be written.
    """
    found_dial, first, last = ends_of(suite.cases[0].scene, dial, start, end)
    check_names(suite)
    where.check_cache()
    folder = SuiteFolder(out)
    folder.claim(suite, runs_of(swept(suite, dial, (first, last))), resume)
    done: dict[str, Mapping[str, Any]] = {}
    runs: list[Run] = []

    def values_at(system: str, value: float) -> Array:
        cell = runs_of(replace(swept(suite, dial, (value,)), systems=(system,)))
        folder.refuse_others(cell)
        runs.extend(cell)
        done.update(finished(cell, folder, where, lambda _: None))
        on_run(len(done))
        return np.array([done[run.key]["record"].get("metrics", {}).get(
            limit.metric.name, np.nan) for run in cell])

    broken = search(values_at, suite.systems, found_dial, (first, last), limit, steps)
    held, = suite.cases[0].points()
    answer = as_json(broken, dial, limit, (first, last), len(suite.seeds), held)
    visited = tuple(sorted({value for each in broken for value, _ in each.visited}))
    _write(out, swept(suite, dial, visited), runs, done, answer)
    return answer


def _write(out: Path, suite: Suite, runs: list[Run], done: Mapping[str, Mapping[str, Any]],
           answer: list[Mapping[str, Any]]) -> None:
    results = results_of(suite, runs, done) | {"breaking": answer}
    results["suite"]["description"] = " ".join(f"{each['statement']}." for each in answer)
    timing = {run.key: done[run.key]["timing"] for run in runs}
    reports = {run.key for run in runs if (out / run.folder / "report.html").is_file()}
    write_json(out / "timing.json", {run.folder: timing[run.key] for run in runs})
    write_bytes(out / "results.csv", results_csv(results).encode())
    write_bytes(out / "report.html", render_suite(results, timing, reports).encode())
    write_json(out / "breaking.json", {"schema": 1, "breaking": answer})
    write_json(out / "results.json", results)
