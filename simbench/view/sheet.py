"""A sequence as one sheet of pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from simbench.errors import UserError
from simbench.sequence import Sequence
from simbench.storage import write_bytes, write_png
from simbench.view.pictures import pictures, tile

_ROWS = 6                # frames on a contact sheet
_SUFFIXES = (".png", ".jpg")


def write_contact_sheet(sequence: Sequence, path: Path) -> None:
    """A PNG or JPEG: a row for each of up to six frames, with colour, depth, masks and flow.

    Masks and flow are the recording's own, else the true ones; columns without either are absent.
    Raises:
        UserError: the path ends in neither .png nor .jpg, or its folder is missing.
        BadFrame: one of the frames cannot be read.
    """
    check_place("--contact-sheet", path, _SUFFIXES)
    picks = np.unique(np.linspace(0, len(sequence) - 1, _ROWS).round().astype(int))
    rows = [[tile(name, picture) for name, picture in
             pictures(sequence, sequence.frame(int(k))).items()] for k in picks]
    width = max(len(row) for row in rows)
    blank = np.full_like(rows[0][0], 255)
    sheet = np.vstack([np.hstack(row + [blank] * (width - len(row))) for row in rows])
    if path.suffix.lower() == ".png":
        write_png(path, sheet)
        return
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(sheet[..., ::-1]))
    write_bytes(path, data.tobytes())


def check_place(option: str, path: Path, suffixes: tuple[str, ...]) -> None:
    """Raises UserError unless the file's name ends in a suffix and its folder is there."""
    if path.suffix.lower() not in suffixes:
        raise UserError(f"{option} {path}: its name must end in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise UserError(f"{option} {path}: there is no folder {path.parent}; make it first")
