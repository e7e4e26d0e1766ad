"""`simbench view`: look at a sequence in Rerun, or as a sheet of pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simbench.cli.options import Calibration
from simbench.errors import UserError


def view_command(
        folder: Annotated[Path, typer.Argument(
            metavar="DIR_OR_RUN", help="The folder of a sequence or of a run.")],
        contact_sheet: Annotated[Path | None, typer.Option(
            "--contact-sheet", metavar="FILE.png",
            help="Write a sheet of colour, depth, masks and flow instead; needs no Rerun.")] = None,
        calibration: Calibration = None) -> None:
    """Look at a sequence or run in Rerun, or as a PNG."""
    from simbench.sequence import open_sequence
    from simbench.view import log_run_to_rerun, log_to_rerun, write_contact_sheet

    if (folder / "metrics.json").exists():
        if contact_sheet is not None:
            raise UserError(f"{folder}: a run has no images for --contact-sheet; its pictures are "
                            "in report.html")
        log_run_to_rerun(folder)
        return
    sequence = open_sequence(folder, calibration)
    if contact_sheet is not None:
        write_contact_sheet(sequence, contact_sheet)
        typer.echo(str(contact_sheet))
        return
    log_to_rerun(sequence)
