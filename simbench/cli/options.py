"""Options that several commands share, and their text turned into values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Annotated

import typer

from simbench.errors import UserError

MAX_SIDE_PX = 8192   # what simbench.world allows, said before MuJoCo is loaded

Seed = Annotated[int, typer.Option("--seed", min=0, help="Of the scene and of all noise.")]
Frames = Annotated[int | None, typer.Option(
    "--frames", min=1, help="How many frames; the scene's own number by default.")]
Size = Annotated[str | None, typer.Option(
    "--size", metavar="WxH", help="Image size in pixels, as 640x480; the scene's by default.")]
Fps = Annotated[float | None, typer.Option(
    "--fps", help="Frames per second; the scene's by default.")]
Sensor = Annotated[str, typer.Option(
    "--sensor", help="Sensor model by name; `simbench list` shows all.")]
Texture = Annotated[float | None, typer.Option(
    "--texture", min=0.0, max=1.0, help="Contrast of all textures: 0 plain colours, 1 full.")]
Rigidity = Annotated[float | None, typer.Option(
    "--rigidity", min=0.0, max=1.0, help="1 rigid objects; lower, the more they deform.")]
DialValues = Annotated[list[str] | None, typer.Option(
    "--dial", metavar="NAME=VALUE", help="Any dial of the scene; may be given several times.")]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Processes that render.")]
Calibration = Annotated[str | None, typer.Option(
    "--calibration", metavar="FILE",
    help="calibration.yaml of a folder that has none, or instead of its own.")]

TrustedScene = Annotated[str | None, typer.Option(
    "--scene", metavar="FILE.py:NAME",
    help="The scene of your own that the sequence was drawn from. It is never run unasked.")]

Systems = Annotated[str | None, typer.Option(
    "--systems", metavar="a,b", help="Other systems than the suite's.")]
Seeds = Annotated[str | None, typer.Option(
    "--seeds", metavar="0-9", help="Other seeds than the suite's.")]
Processes = Annotated[int | None, typer.Option(
    "--workers", min=1, help="Processes; one for each processor by default, one alone where a "
                             "table measures time.")]
Dask = Annotated[str, typer.Option(
    "--dask", metavar="ADDRESS", help="The scheduler of a Dask cluster to run on.")]
Cache = Annotated[str, typer.Option(
    "--cache", metavar="PLACE", help="Folder or URL (fsspec) that keeps rendered sequences.")]
Reports = Annotated[str, typer.Option(
    "--reports", help="Which runs get a report.html: of the first seed, all or none.")]
Resume = Annotated[bool, typer.Option(
    "--resume", help="Go on in a folder that was begun: where it was killed, or with more systems, "
                     "seeds or cases (or another table of the same suite).")]
TimeLimit = Annotated[float | None, typer.Option(
    "--time-limit", min=0.1, metavar="SECONDS",
    help="End a command:\"program …\" that takes longer; the run is lost.")]
MemoryLimit = Annotated[float | None, typer.Option(
    "--memory-limit", min=1.0, metavar="MB",
    help="End a command:\"program …\" that holds more; the run is lost.")]


def trust_scene(scene: str | None) -> None:
    """Load a scene that the user names, so that a sequence of it may be asked for its truth.

    Raises:
        UserError: there is no such scene.
    """
    if scene is not None:
        from simbench.scene import find_scene
        find_scene(scene)


def parse_size(text: str | None) -> tuple[int, int] | None:
    """"640x480" to (640, 480). Raises UserError when it is anything else."""
    if text is None:
        return None
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip().lower())
    if match is None:
        raise UserError(f"--size {text}: wanted width and height as in 640x480")
    size = int(match[1]), int(match[2])
    if max(size) > MAX_SIDE_PX:
        raise UserError(f"--size {text}: at most {MAX_SIDE_PX} pixels a side")
    return size


def collect_dials(dials: Iterable[str] | None, texture: float | None,
                  rigidity: float | None) -> dict[str, float | str]:
    """The dials given by --dial, --texture and --rigidity; the rest stay the scene's defaults.

    Raises:
        UserError: not NAME=VALUE, or a dial given twice.
    """
    values: dict[str, float | str] = {
        name: value for name, value in (("texture", texture), ("rigidity", rigidity))
        if value is not None}
    return parse_dials("--dial", dials, values)


def parse_dials(option: str, texts: Iterable[str] | None, known: Mapping[str, float | str]
                ) -> dict[str, float | str]:
    """NAME=VALUE of every text beside those known; the scene knows which dials and values it has.

    Raises:
        UserError: not NAME=VALUE, or a dial given twice.
    """
    values = dict(known)
    for text in texts or ():
        name, equals, number = (part.strip() for part in text.partition("="))
        if not equals or not name or not number:
            raise UserError(f"{option} {text}: wanted NAME=VALUE, as in speed=0.5")
        if name in values:
            raise UserError(f"{option} {text}: dial {name!r} is given twice")
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = number    # the name of a choice
    return values
