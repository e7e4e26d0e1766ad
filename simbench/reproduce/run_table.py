"""A table from its name to its files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from simbench.reproduce.files import markdown, numbers_csv
from simbench.reproduce.measured import Measured
from simbench.reproduce.page import render
from simbench.reproduce.side_by_side import Reproduction, reproduction
from simbench.reproduce.table import PaperTable
from simbench.storage import write_bytes
from simbench.suites.files import load_suite
from simbench.suites.jobs import runs_of
from simbench.suites.run_suite import Where, run_suite
from simbench.suites.spec import Suite

_FEWEST_FRAMES = 2


def suite_of(table: PaperTable, *, systems: tuple[str, ...] | None = None,
             seeds: tuple[int, ...] | None = None, frames: int | None = None,
             size: tuple[int, int] | None = None) -> Suite:
    """The suite behind a table, with other systems, seeds, frames or image size.

    Args:
        frames: of the longest sequence; the others keep their share of it.
    """
    suite = load_suite(table.suite).changed(systems=systems, seeds=seeds, size=size)
    longest = max(case.frames or 0 for case in suite.cases)
    if frames is None or not longest:
        return suite
    return replace(suite, cases=tuple(
        replace(case, frames=max(_FEWEST_FRAMES, round(frames * (case.frames or longest)
                                                       / longest)))
        for case in suite.cases))


def reproduce(table: PaperTable, suite: Suite, out: Path, where: Where, *, resume: bool = False,
              on_run: Callable[[int], None] = lambda done: None
              ) -> tuple[Reproduction, dict[str, Any]]:
    """Run what is not done yet, and write NAME.html, NAME.md and NAME.csv beside the suite's own.

    Tables of one suite may share a folder: those after the first find its runs done.

    Returns:
        What the page says, and the suite's results.json.
    Raises:
        UserError: an unknown system, or the folder is something else's.
        OSError: the folder cannot be written.
    """
    results = run_suite(suite, out, where, resume=resume, on_run=on_run)
    measured = Measured(table, runs_of(suite), results["runs"], out)
    found = reproduction(table, suite, measured)
    write_bytes(out / f"{table.name}.csv", numbers_csv(table, measured).encode())
    write_bytes(out / f"{table.name}.md", markdown(found).encode())
    write_bytes(out / f"{table.name}.html", render(found).encode())
    return found, results
