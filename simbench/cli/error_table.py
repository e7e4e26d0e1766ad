"""Tables in the terminal, and what `run` and `score` print when they are done."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from simbench.outcome import Outcome
    from simbench.report.table import ErrorTable


def print_table(table: ErrorTable, console: Console | None = None) -> None:
    """A table without its notes; by default its lines break where the terminal ends."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(table.columns):
        shown.add_column(column, justify="left" if i == 0 else "right")
    for row in table.rows:
        shown.add_row(*row)
    (console or Console(highlight=False, width=500)).print(shown)


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
