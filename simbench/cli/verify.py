"""`simbench verify`: every hash and invariant of a sequence."""

from __future__ import annotations

from typing import Annotated

import typer

from simbench.cli.options import Calibration, TrustedScene, trust_scene
from simbench.errors import UserError

_SHOWN = 20   # problems listed; the count tells of the rest


def verify_command(
        place: Annotated[str, typer.Argument(
            metavar="DIR", help="A sequence's folder, or its URL in object storage.")],
        calibration: Calibration = None, scene: TrustedScene = None) -> None:
    """Check a sequence's hashes and invariants.

    Also whether it would be drawn the same here.
    """
    from simbench.cli.progress import frame_progress
    from simbench.datasets.simbench_folder import SimbenchFolder
    from simbench.remote import local_folder
    from simbench.sequence import open_sequence
    from simbench.verify import check_sequence, drawn_here

    trust_scene(scene)
    folder = local_folder(place)
    sequence = open_sequence(folder, calibration)
    with frame_progress("verify", len(sequence)) as advance:
        problems = check_sequence(folder, sequence, advance)
    for problem in problems[:_SHOWN]:
        typer.echo(problem)
    if problems:
        raise UserError(f"{folder}: {len(problems)} problem{'s' * (len(problems) > 1)}, the first: "
                        f"{problems[0]}; restore the files or generate the sequence again")
    typer.echo(f"{place}: {len(sequence)} frames, all good")
    if isinstance(sequence, SimbenchFolder):
        try:
            others = drawn_here(sequence)
        except UserError as error:
            typer.echo("certificate: whether it would be drawn the same here is not known: "
                       f"{error}")
            return
        for other in others:
            typer.echo(f"certificate: {other}")
        typer.echo("certificate: drawn here, its bytes could be others" if others else
                   "certificate: drawn here, it has the same bytes (last frame tried)")
