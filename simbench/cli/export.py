"""`simbench export`: a sequence in another layout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simbench.cli.options import Calibration, TrustedScene, trust_scene
from simbench.errors import UserError


def export_command(
        place: Annotated[str, typer.Argument(
            metavar="DIR", help="A sequence's folder, or its URL in object storage.")],
        layout: Annotated[str, typer.Option("--format", help="vdo, kitti, tum or rosbag2.")],
        out: Annotated[Path, typer.Option("--out", metavar="DIR2", help="Folder to write.")],
        calibration: Calibration = None, scene: TrustedScene = None) -> None:
    """Write a sequence in a layout that other programs read."""
    from simbench.cli.progress import frame_progress
    from simbench.export import export_whole, find_exporter
    from simbench.remote import local_folder
    from simbench.sequence import open_sequence

    find_exporter(layout)      # a wrong name shows before the sequence is read
    trust_scene(scene)
    folder = local_folder(place)
    sequence = open_sequence(folder, calibration)
    if out.resolve().is_relative_to(folder.resolve()):
        raise UserError(f"--out {out}: lies within {folder}, whose files would no longer be those "
                        "of the recording; choose a folder outside it")
    with frame_progress(f"export {layout}", len(sequence)) as advance:
        export_whole(layout, sequence, out, advance)
    typer.echo(f"{out}: {len(sequence)} frames in the {layout} layout")
