"""`simbench reproduce`: a paper's table beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simbench.cli.options import (
    Cache,
    Dask,
    MemoryLimit,
    Processes,
    Reports,
    Resume,
    Seeds,
    Size,
    Systems,
    TimeLimit,
)
from simbench.cli.suite_options import changes_of, tell_trouble, where_of

if TYPE_CHECKING:
    from simbench.reproduce.side_by_side import Reproduction


def reproduce_command(
        name: Annotated[str, typer.Argument(
            metavar="TABLE", help="As `simbench list` names it, such as sdpl-table1.")],
        out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")],
        systems: Systems = None, seeds: Seeds = None,
        frames: Annotated[int | None, typer.Option(
            "--frames", min=2, help="Of the longest sequence; shorter ones keep their share. A "
                                    "short run is the default.")] = None,
        size: Size = None, workers: Processes = None, dask: Dask = "", cache: Cache = "",
        reports: Reports = "first", resume: Resume = False,
        time_limit: TimeLimit = None, memory_limit: MemoryLimit = None,
) -> None:
    """Set a paper's table beside ours, of synthetic counterparts."""
    from simbench.cli.progress import run_progress
    from simbench.reproduce.run_table import reproduce, suite_of
    from simbench.reproduce.table import load_table
    from simbench.suites.jobs import runs_of

    table = load_table(name)
    if workers is None and not dask and table.measures_time:
        workers = 1
    where = where_of(workers, dask, cache, reports, time_limit, memory_limit)
    suite = suite_of(table, **changes_of(systems, seeds, frames, size))
    runs = runs_of(suite)
    typer.echo(f"{table.title}: {len(suite.cases)} sequences, {len(suite.seeds)} seeds, "
               f"{len(suite.systems)} systems, {len(runs)} runs", err=True)
    with run_progress(table.name, len(runs)) as show:
        found, results = reproduce(table, suite, out, where, resume=resume, on_run=show)
    _tell(found)
    typer.echo(f"table: {out / f'{table.name}.html'}, .md and .csv; suite: {out / 'report.html'}")
    tell_trouble(results)


def _tell(found: Reproduction) -> None:
    """What fits a terminal: one system against another, and the correlation."""
    from simbench.cli.error_table import print_table
    from simbench.reproduce.side_by_side import correlation_lines

    for each in found.comparisons or tuple(side.flat() for side in found.sides):
        print_table(each)
    if found.correlated is not None:
        for line in correlation_lines(found.correlated):
            typer.echo(line)
