"""`simbench bless` and `simbench gate`: record a baseline on purpose, and hold runs against it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Place = Annotated[Path, typer.Argument(metavar="RUN_OR_SUITE", help="The folder of either.")]
BaselineFile = Annotated[Path, typer.Option("--baseline", metavar="FILE", help="A JSON file.")]


def bless_command(place: Place, baseline: BaselineFile) -> None:
    """Write results down as a baseline for gates.

    Do so on purpose: later results are held against these.
    """
    from simbench.baseline import bless

    found = bless(place, baseline)
    typer.echo(f"{baseline}: {found.name}, {_counted(len(found.runs), 'run')}, "
               f"{', '.join(metric.name for metric in found.metrics)}")


def gate_command(place: Place, baseline: BaselineFile) -> None:
    """Fail where results are worse than a baseline.

    They are compared in pairs of equal sequences; exit code 1 on a regression beyond noise.
    """
    from simbench.baseline import outcome_of, read_baseline
    from simbench.gate import judge

    verdict = judge(read_baseline(baseline), outcome_of(place))
    if verdict.other_bytes:
        typer.echo(f"note: {_counted(len(verdict.other_bytes), 'sequence')} of other bytes than "
                   "the baseline's (another processor, Mesa or library version), first: "
                   f"{verdict.other_bytes[0]}")
    for change in verdict.improvements:
        typer.echo(f"better: {change}")
    if verdict.improvements:
        typer.echo("bless these results, so that what was gained cannot be lost")
    for run in verdict.lost:
        typer.echo(f"LOST: {run}")
    for change in verdict.regressions:
        typer.echo(f"WORSE: {change}")
    if not verdict.passed:
        typer.echo(f"gate failed: {len(verdict.regressions)} of {verdict.compared} comparisons "
                   f"are worse beyond noise, {len(verdict.lost)} runs or values are lost")
        raise typer.Exit(1)
    typer.echo(f"gate passed: {_counted(verdict.compared, 'comparison')}")


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
