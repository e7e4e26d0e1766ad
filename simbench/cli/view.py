"""`simbench view`: look at a sequence in Rerun, or as a sheet of pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simbench.cli.options import Calibration


def view_command(
        folder: Annotated[Path, typer.Argument(metavar="DIR", help="A sequence's folder.")],
        contact_sheet: Annotated[Path | None, typer.Option(
            "--contact-sheet", metavar="FILE.png",
            help="Write a sheet of colour, depth, masks and flow instead; needs no Rerun.")] = None,
        calibration: Calibration = None) -> None:
    """Look at a sequence in Rerun or as a PNG sheet."""
    from simbench.sequence import open_sequence
    from simbench.view import log_to_rerun, write_contact_sheet

    sequence = open_sequence(folder, calibration)
    if contact_sheet is not None:
        write_contact_sheet(sequence, contact_sheet)
        typer.echo(str(contact_sheet))
        return
    log_to_rerun(sequence)
