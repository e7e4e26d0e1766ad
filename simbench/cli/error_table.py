"""Tables in the terminal, and what `run` and `score` print when they are done."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from simbench.outcome import Outcome
    from simbench.report.table import ErrorTable

_GAP = 2     # characters between columns


def print_table(table: ErrorTable, console: Console | None = None) -> None:
    """A table without its notes, to a console or, in parts that fit its width, to the terminal.

    Into a pipe it is one table, however wide, so that grep finds each row whole.
    """
    from rich.console import Console

    if console is not None:
        _print(table, console)
    elif sys.stdout.isatty():
        for part in parts_that_fit(table, shutil.get_terminal_size().columns):
            _print(part, Console(highlight=False))
    else:
        _print(table, Console(highlight=False, width=500))


def parts_that_fit(table: ErrorTable, width: int) -> list[ErrorTable]:
    """The table's columns in groups no wider than `width` characters, the first column in each.

    A column wider than that stands alone.
    """
    cells = (table.columns, *table.rows)
    widths = [_GAP + max(len(row[i]) for row in cells) for i in range(len(table.columns))]
    groups: list[list[int]] = []
    for i in range(1, len(widths)):
        if not groups or widths[0] + sum(widths[k] for k in groups[-1]) + widths[i] > width:
            groups.append([])
        groups[-1].append(i)
    return [replace(table, columns=tuple(table.columns[k] for k in (0, *group)),
                    rows=tuple(tuple(row[k] for k in (0, *group)) for row in table.rows))
            for group in groups]


def _print(table: ErrorTable, console: Console) -> None:
    from rich import box
    from rich.table import Table

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(table.columns):
        shown.add_column(column, justify="left" if i == 0 else "right")
    for row in table.rows:
        shown.add_row(*row)
    console.print(shown)


def print_outcome(outcome: Outcome, out: Path) -> None:
    """The tables of errors, what went wrong, the time a frame took, and where the report is."""
    from rich.console import Console

    from simbench.report.table import error_table, trajectory_table

    console = Console(highlight=False)
    errors = error_table(outcome.metrics)
    tables = (errors, trajectory_table(outcome.metrics)) if outcome.frames > 1 else ()
    for part in tables:
        if part.rows:
            print_table(part, console)
    if outcome.frames == 1:
        console.print("one frame holds no motion: there is nothing to score", markup=False)
    for note in errors.notes if outcome.frames > 1 else ():
        console.print(note, markup=False)
    timing = outcome.metrics.get("timing", {})
    if "ms_per_frame_median" in timing:
        console.print(f"{timing['ms_per_frame_median']:.1f} ms a frame (median), "
                      f"{timing['ms_per_frame_p95']:.1f} ms at the 95th percentile, "
                      f"{timing['ms_first_frame']:.1f} ms for the first, which is in neither",
                      markup=False, soft_wrap=True)
    if outcome.lost:
        console.print(f"{outcome.lost} of {outcome.frames} frames have no pose", markup=False)
    if outcome.log:
        entries = "1 entry" if len(outcome.log) == 1 else f"{len(outcome.log)} entries"
        console.print(f"{entries} in {out / 'log.txt'}", markup=False, soft_wrap=True)
    console.print(f"report: {out / 'report.html'}", markup=False, soft_wrap=True)
    for warning in outcome.warnings:
        print("WARNING: " + " ".join(warning.split()), file=sys.stderr)
