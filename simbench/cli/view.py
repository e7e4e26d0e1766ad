"""`simbench view`: look at a sequence or a run in Rerun, as a sheet of pictures, as a video."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simbench.cli.options import Calibration, TrustedScene, trust_scene
from simbench.errors import UserError

if TYPE_CHECKING:
    from simbench.sequence import Sequence


def view_command(
        place: Annotated[str, typer.Argument(
            metavar="DIR_OR_RUN", help="The folder of a sequence or of a run.")],
        contact_sheet: Annotated[Path | None, typer.Option(
            "--contact-sheet", metavar="FILE.png",
            help="Write a sheet of colour, depth, masks and flow instead; needs no Rerun.")] = None,
        mp4: Annotated[Path | None, typer.Option(
            "--mp4", metavar="FILE.mp4", help="Write a video of them; needs no Rerun.")] = None,
        save: Annotated[Path | None, typer.Option(
            "--save", metavar="FILE.rrd",
            help="Write a recording for Rerun instead of starting its viewer.")] = None,
        sequence_of_run: Annotated[Path | None, typer.Option(
            "--sequence", metavar="DIR", help="The recording that a run was made on: its frames "
            "and truth are shown, too. Scenes are drawn again by themselves.")] = None,
        calibration: Calibration = None, scene: TrustedScene = None) -> None:
    """Look at a sequence or run in Rerun, or as a PNG or MP4."""
    from simbench.cli.progress import frame_progress
    from simbench.remote import local_folder
    from simbench.sequence import open_sequence
    from simbench.view.recording import record_run, record_sequence
    from simbench.view.sheet import write_contact_sheet
    from simbench.view.video import write_video

    trust_scene(scene)
    folder = local_folder(place)
    if (folder / "metrics.json").exists():
        for option, path in (("--contact-sheet", contact_sheet), ("--mp4", mp4)):
            if path is not None:
                raise UserError(f"{folder}: a run has no images for {option}; its pictures are "
                                "in report.html")
        with _sequence_of(folder, sequence_of_run, calibration) as sequence:
            record_run(folder, sequence, save)
        _tell(save)
        return
    if sequence_of_run is not None:
        raise UserError(f"--sequence {sequence_of_run}: {folder} is no run; leave it out")
    sequence = open_sequence(folder, calibration)
    if contact_sheet is not None:
        write_contact_sheet(sequence, contact_sheet)
    if mp4 is not None:
        with frame_progress("video", len(sequence)) as advance:
            write_video(sequence, mp4, advance)
    if save is not None or (contact_sheet is None and mp4 is None):
        record_sequence(sequence, save)
    _tell(contact_sheet, mp4, save)


def _tell(*written: Path | None) -> None:
    for path in written:
        if path is not None:
            typer.echo(str(path))


@contextmanager
def _sequence_of(run: Path, given: Path | None, calibration: str | None
                 ) -> Iterator[Sequence | None]:
    """What a run was made on: the folder given, else its scene drawn again, else None."""
    if given is not None:
        from simbench.sequence import open_sequence
        yield open_sequence(given, calibration)
        return
    from simbench.render import make_renderer
    from simbench.run_source import read_source
    from simbench.simulate import SimulatedSequence
    source = read_source(run)
    if source is None:
        typer.echo(f"{run}: give --sequence DIR to see its frames and truth, too", err=True)
        yield None
        return
    world = source.make_world()
    renderer = make_renderer("mujoco", world)
    try:
        yield SimulatedSequence(world, renderer, source.frames)
    finally:
        renderer.close()
