"""How far a command is, on stderr: a bar with the time left, or lines where it is no terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

import typer

_A_LINE_EVERY_S = 60.0      # for the logs of CI and of clusters


@contextmanager
def frame_progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Of `total` frames; call the function it gives once for each frame done."""
    count = 0
    with _progress(what, total, "frames", rate=True) as show:
        def advance() -> None:
            nonlocal count
            count += 1
            show(count)

        yield advance


@contextmanager
def run_progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Of `total` runs; call the function it gives with the number of runs done."""
    with _progress(what, total, "runs", rate=False) as show:
        yield show


@contextmanager
def _progress(what: str, total: int, unit: str, *, rate: bool) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lines(what, total, unit)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
               TextColumn("{task.fields[speed]}" if rate else unit), TimeElapsedColumn(),
               TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(what, total=total, speed="")

        def show(done: int) -> None:
            speed = progress.tasks[0].speed
            progress.update(task, completed=done,
                            speed="" if speed is None else f"{speed:.1f} fps")

        yield show


def lines(what: str, total: int, unit: str, now: Callable[[], float] = time.monotonic
          ) -> Callable[[int], None]:
    """Call what it gives with how many are done: "smoke: 4 of 9 runs, 0:01:20, left 0:01:40".

    Says nothing in the first minute, nor more than once a minute. What was done at the first call,
    as when a suite is resumed, took no time of this one.
    """
    began = told = now()
    before: int | None = None

    def show(done: int) -> None:
        nonlocal told, before
        before = done if before is None else before
        at = now()
        if at - told < _A_LINE_EVERY_S or done <= before or done >= total:
            return
        told = at
        left = (at - began) / (done - before) * (total - done)
        typer.echo(f"{what}: {done} of {total} {unit}, {_clock(at - began)}, left {_clock(left)}",
                   err=True)

    return show


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
