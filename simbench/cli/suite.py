"""`simbench suite`: scenes × dials × seeds × systems."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from simbench.cli.options import (
    Cache,
    Dask,
    MemoryLimit,
    Processes,
    Reports,
    Resume,
    Seeds,
    Systems,
    TimeLimit,
    parse_dials,
)
from simbench.cli.suite_options import changes_of, split_names, tell_trouble, where_of
from simbench.errors import UserError

if TYPE_CHECKING:
    from simbench.suites.run_suite import Where
    from simbench.suites.spec import Suite


def suite_command(
        name: Annotated[str, typer.Argument(
            metavar="NAME", help="As `simbench list` names it, a YAML file, or `break`: search the "
                                 "value of --dial at which each system crosses --limit.")],
        out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")],
        cases: Annotated[str | None, typer.Option(
            "--cases", metavar="a,b", help="Only these cases of the suite.")] = None,
        systems: Systems = None, seeds: Seeds = None, workers: Processes = None, dask: Dask = "",
        resume: Resume = False,
        frames: Annotated[int | None, typer.Option(
            "--frames", min=1, help="Only so many frames of each sequence.")] = None,
        size: Annotated[str | None, typer.Option(
            "--size", metavar="WxH",
            help="Another image size than the suite's, as 640x480.")] = None,
        cache: Cache = "", reports: Reports = "first",
        resolution: Annotated[float, typer.Option(
            "--resolution", min=0.1, metavar="PERCENT",
            help="Of a mean; for which the page tells how many seeds are needed.")] = 5.0,
        time_limit: TimeLimit = None, memory_limit: MemoryLimit = None,
        dial: Annotated[str | None, typer.Option(
            "--dial", metavar="NAME", help="break: the dial to turn.")] = None,
        held: Annotated[list[str] | None, typer.Option(
            "--with", metavar="NAME=VALUE",
            help="break: another dial, held at this value; may be given several times.")] = None,
        limit: Annotated[str | None, typer.Option(
            "--limit", metavar="METRIC=VALUE",
            help="break: what counts as broken; camera.coverage=0.9 by default.")] = None,
        scene: Annotated[str | None, typer.Option(
            "--scene", help="break: SwingingBoxes-v0 by default.")] = None,
        flow: Annotated[str | None, typer.Option(
            "--flow", help="break: truth, noisy or dis (from the images, the default).")] = None,
        sensor: Annotated[str | None, typer.Option(
            "--sensor", help="break: gaussian by default.")] = None,
        start: Annotated[float | None, typer.Option(
            "--from", help="break: the easy end; the dial's default by default.")] = None,
        end: Annotated[float | None, typer.Option(
            "--to", help="break: the hard end; the farther end of the dial by default.")] = None,
) -> None:
    """Run a suite and write one page of curves and tables."""
    from simbench.cli.progress import run_progress
    from simbench.suites.files import load_suite
    from simbench.suites.run_suite import run_suite

    where = where_of(workers, dask, cache, reports, time_limit, memory_limit)
    changes = changes_of(systems, seeds, frames, size)
    search = {"--dial": dial, "--with": held, "--limit": limit, "--scene": scene, "--flow": flow,
              "--sensor": sensor, "--from": start, "--to": end}
    if name == "break":
        if cases is not None:
            raise UserError("--cases: a search has none; leave it out")
        if dial is None:
            raise UserError("suite break: which dial? Give --dial NAME, as `simbench list` names "
                            "them")
        suite = _searched(scene or "SwingingBoxes-v0", flow or "dis", sensor or "gaussian", limit,
                          dial, held)
        _break(suite.changed(**changes), dial, limit, start, end, out, where, resume)
        return
    for option, value in search.items():
        if value is not None:
            raise UserError(f"{option}: is for `simbench suite break`; a suite's file says it")
    suite = load_suite(name).changed(**changes)
    if cases is not None:
        suite = suite.with_cases(split_names("--cases", cases))
    with run_progress(suite.name, _count(suite)) as show:
        results = run_suite(suite, out, where, resume=resume, resolution=resolution / 100.0,
                            on_run=show)
    _tell(results, out)


def _searched(scene: str, flow: str, sensor: str, limit: str | None, dial: str,
              held: list[str] | None) -> Suite:
    """What a search runs at each value of its dial."""
    from simbench.metric_names import SHOWN
    from simbench.suites.breaking import DEFAULT_LIMIT, Limit, held_dials
    from simbench.suites.spec import Case, Suite

    metric = Limit.parse(limit or DEFAULT_LIMIT).metric.name
    others = held_dials(scene, dial, parse_dials("--with", held, {}))
    case = Case("break", scene, frames=30, size=(320, 240),
                inputs={"flow": flow, "sensor": sensor},
                sweep=tuple((name, (value,)) for name, value in others))
    return Suite("break", 1, "", (case,), ("sdpl",), tuple(range(5)),
                 tuple(dict.fromkeys((metric, *SHOWN))))


def _break(suite: Suite, dial: str, limit: str | None, start: float | None,
           end: float | None, out: Path, where: Where, resume: bool) -> None:
    from simbench.cli.progress import run_progress
    from simbench.suites.breaking import DEFAULT_LIMIT, DEFAULT_STEPS, Limit
    from simbench.suites.run_break import run_break

    most = len(suite.systems) * len(suite.seeds) * (DEFAULT_STEPS + 2)
    with run_progress(f"break {dial}", most) as show:
        answer = run_break(suite, dial, Limit.parse(limit or DEFAULT_LIMIT), out, where,
                           start=start, end=end, resume=resume, on_run=show)
    for each in answer:
        typer.echo(each["statement"])
    typer.echo(f"report: {out / 'report.html'}")


def _count(suite: Suite) -> int:
    return sum(1 for _ in suite.cells()) * len(suite.systems) * len(suite.seeds)


def _tell(results: dict[str, Any], out: Path) -> None:
    """The table of the terminal. Exit code 1 where a run was lost or failed."""
    from simbench.cli.error_table import print_table
    from simbench.report.suite_page import summary_table

    print_table(summary_table(results))
    typer.echo("means over the seeds [95 % by bootstrap]")
    typer.echo(f"report: {out / 'report.html'}")
    tell_trouble(results)
