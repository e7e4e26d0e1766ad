"""Text files of rows: a broken row is named by file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.errors import BadFile
from simbench.untrusted import read_text
from slam.geometry.arrays import Array

_LARGEST = 2.0**31
_FAR = 1e15              # beyond it a stamp or a length says nothing
_MOST_FRAMES = 1_000_000


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line number and words of every row; empty lines and comments (#) are left out."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.replace(",", " ").split("#", 1)[0].split()
        if words:
            rows.append((number, words))
    return rows


def read_numbers(path: Path, columns: int, meaning: str) -> Array:
    """Rows of at least `columns` finite numbers, as (N, columns) float64; more are ignored.

    Args:
        meaning: the columns as the error message names them, such as "t tx ty tz qx qy qz qw".
    Raises:
        BadFile: a row is too short, not numeric, or not finite; names the line.
    """
    rows = [numbers_of(path, line, words, columns, meaning) for line, words in read_rows(path)]
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def numbers_of(path: Path, line: int, words: list[str], columns: int, meaning: str) -> list[float]:
    """The first `columns` words of one row as finite floats. Raises BadFile naming the line."""
    if len(words) < columns:
        raise BadFile(f"{path}:{line}: {len(words)} columns, wanted {columns} ({meaning}); "
                      "mend or remove this row")
    try:
        numbers = [float(word) for word in words[:columns]]
    except ValueError as error:
        raise BadFile(f"{path}:{line}: {str(error)[:100]}, wanted numbers ({meaning}); "
                      "mend or remove this row") from None
    if not np.all(np.isfinite(numbers)):
        raise BadFile(f"{path}:{line}: a number is not finite ({meaning}); "
                      "mend or remove this row")
    if max(map(abs, numbers), default=0.0) > _FAR:
        raise BadFile(f"{path}:{line}: a number is beyond {_FAR:g} ({meaning}); "
                      "mend or remove this row")
    return numbers


def whole_numbers(path: Path, numbers: Array, meaning: str) -> Array:
    """A column (N,) as int64. Raises BadFile where one is not whole or too large."""
    wrong = (numbers != np.round(numbers)) | (np.abs(numbers) > _LARGEST)
    if np.any(wrong):
        raise BadFile(f"{path}: {meaning} is {numbers[np.argmax(wrong)]:g}, wanted a whole number; "
                      "mend or remove this row")
    return np.asarray(numbers.astype(np.int64))


def check_increasing(path: Path, stamps_s: Array) -> Array:
    """The stamps, (K,) in seconds. Raises BadFile unless there are some and they increase."""
    if len(stamps_s) == 0:
        raise BadFile(f"{path}: no rows in it; a sequence needs at least one frame")
    if len(stamps_s) > _MOST_FRAMES:
        raise BadFile(f"{path}: {len(stamps_s)} rows; at most {_MOST_FRAMES} frames can be read")
    late = np.flatnonzero(np.diff(stamps_s) <= 0)
    if len(late):
        k = int(late[0]) + 1
        raise BadFile(f"{path}: stamp {stamps_s[k]:.6f} of row {k + 1} is not later than the one "
                      "before it; sort the rows by time")
    return stamps_s
