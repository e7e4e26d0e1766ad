"""`simbench generate`: a scene as a sequence on disk."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simbench.cli.options import (
    DialValues,
    Fps,
    Frames,
    Rigidity,
    Seed,
    Sensor,
    Size,
    Texture,
    Workers,
    collect_dials,
    parse_size,
)
from simbench.errors import UserError

if TYPE_CHECKING:
    from simbench.generate import GenerateSettings


def generate_command(
        scene: Annotated[str, typer.Argument(metavar="SCENE", help="As `simbench list` names it.")],
        out: Annotated[str, typer.Option(
            "--out", metavar="DIR", help="Folder to write, or a URL in object storage.")],
        seed: Seed = 0, frames: Frames = None, size: Size = None, fps: Fps = None,
        sensor: Sensor = "ideal", texture: Texture = None, rigidity: Rigidity = None,
        dial: DialValues = None,
        stereo: Annotated[bool, typer.Option("--stereo", help="Right images, too.")] = False,
        workers: Workers = 1,
        resume: Annotated[bool, typer.Option(
            "--resume", help="Go on where a killed run stopped; the bytes are the same.")] = False,
) -> None:
    """Render a scene to disk.

    What comes out is a TUM RGB-D folder with masks and exact truth beside it.
    """
    from simbench.generate import GenerateSettings
    from simbench.remote import check_free, is_url, store

    settings = GenerateSettings.resolve(
        scene, seed=seed, frames=frames, size=parse_size(size), fps=fps, sensor=sensor,
        dials=collect_dials(dial, texture, rigidity), stereo=stereo)
    if is_url(out):
        if resume:
            raise UserError(f"--resume: {out} holds whole sequences only; leave it out")
        check_free(out)     # what is wrong there shows before anything is rendered
        with tempfile.TemporaryDirectory(prefix="simbench-") as scratch:
            folder = Path(scratch) / "sequence"
            _generate(settings, folder, out, workers, resume)
            store(folder, out)
    else:
        _generate(settings, Path(out), out, workers, resume)


def _generate(settings: GenerateSettings, folder: Path, place: str, workers: int, resume: bool
              ) -> None:
    """Render, and tell how fast."""
    from simbench.cli.progress import frame_progress
    from simbench.generate import generate

    start_s = time.perf_counter()
    with frame_progress(settings.scene, settings.frames) as advance:
        rendered = generate(settings, folder, workers=workers, resume=resume, on_frame=advance)
    seconds = time.perf_counter() - start_s
    megabytes = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    kept = f" ({settings.frames - rendered} were there already)" * (rendered < settings.frames)
    typer.echo(f"{place}: {rendered} frames{kept} in {seconds:.1f} s, {rendered / seconds:.1f} "
               f"frames/s, {megabytes:.1f} MB")
