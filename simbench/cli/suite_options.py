"""What the commands that do a suite's runs make of their options, and how they end."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import typer

from simbench.cli.options import parse_size
from simbench.errors import UserError

if TYPE_CHECKING:
    from simbench.suites.run_suite import Where


def where_of(workers: int | None, dask: str, cache: str, reports: str,
             time_limit: float | None, memory_limit: float | None) -> Where:
    """How the runs are worked off, from the options. Raises UserError."""
    from simbench.program import Limits
    from simbench.suites.run_suite import Where

    if reports not in ("first", "all", "none"):
        raise UserError(f"--reports {reports}: wanted first, all or none")
    if dask and workers is not None:
        raise UserError("--workers: the cluster has its own workers; leave it out with --dask")
    return Where(workers, dask, cache, reports, Limits(time_limit, memory_limit))


def changes_of(systems: str | None, seeds: str | None, frames: int | None, size: str | None
               ) -> dict[str, Any]:
    """What the command line says otherwise than the suite; None where it says nothing.

    Raises:
        UserError: an option that cannot be read.
    """
    from simbench.suites.spec import parse_seeds

    return {"systems": None if systems is None else split_names("--systems", systems),
            "seeds": None if seeds is None else parse_seeds(seeds), "frames": frames,
            "size": parse_size(size)}


def split_names(option: str, text: str) -> tuple[str, ...]:
    """"a,b" to its names; a comma within quotes divides nothing. Raises UserError."""
    outside_quotes = r",(?=(?:[^\"']|\"[^\"]*\"|'[^']*')*$)"
    names = tuple(each.strip() for each in re.split(outside_quotes, text))
    if not all(names):
        raise UserError(f"{option} {text!r}: wanted names with commas between, as in a,b")
    if len(set(names)) < len(names):
        raise UserError(f"{option} {text!r}: a name stands there twice")
    return names


def tell_trouble(results: dict[str, Any]) -> None:
    """Exit code 1, and why, where a run was lost or failed."""
    bad = [run for run in results["runs"] if run["status"] != "done"]
    if bad:
        first = bad[0]
        typer.echo(f"error: {len(bad)} of {len(results['runs'])} runs lost or failed, first: "
                   f"{first['folder']}: {first['reason']}", err=True)
        raise typer.Exit(1)
