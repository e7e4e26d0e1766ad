"""`simbench score`: what another program estimated, against a sequence's truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simbench.cli.options import Calibration


def score_command(
        truth: Annotated[str, typer.Option(
            "--truth", metavar="DIR", help="The folder of the sequence, or its URL.")],
        trajectory: Annotated[Path, typer.Option(
            "--trajectory", metavar="EST.txt", help="TUM rows: t tx ty tz qx qy qz qw.")],
        out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder to write.")],
        objects: Annotated[Path | None, typer.Option(
            "--objects", metavar="EST_OBJECTS.txt",
            help="Rows as in a run's object_motions.txt or objects.txt.")] = None,
        calibration: Calibration = None) -> None:
    """Score estimates of any program."""
    from simbench.cli.error_table import print_outcome
    from simbench.score_to_folder import score_to_folder
    from simbench.sequence import open_sequence

    sequence = open_sequence(truth, calibration)
    print_outcome(score_to_folder(sequence, trajectory, objects, out), out)
