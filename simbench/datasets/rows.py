"""Text files of rows: a broken row is named by file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.errors import BadFile
from slam.geometry.arrays import Array


def read_text(path: Path) -> str:
    """The text of a file. Raises BadFile when it is missing or not text."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadFile(f"{path}: no such file; check the path") from None
    except UnicodeDecodeError:
        raise BadFile(f"{path}: not a text file; replace it") from None
    except OSError as error:
        raise BadFile(f"{path}: cannot be read ({error.strerror}); check the path") from None


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
        raise BadFile(f"{path}:{line}: {error}, wanted numbers ({meaning}); "
                      "mend or remove this row") from None
    if not np.all(np.isfinite(numbers)):
        raise BadFile(f"{path}:{line}: a number is not finite ({meaning}); "
                      "mend or remove this row")
    return numbers


def check_increasing(path: Path, stamps_s: Array) -> Array:
    """The stamps, (K,) in seconds. Raises BadFile unless there are some and they increase."""
    if len(stamps_s) == 0:
        raise BadFile(f"{path}: no rows in it; a sequence needs at least one frame")
    late = np.flatnonzero(np.diff(stamps_s) <= 0)
    if len(late):
        k = int(late[0]) + 1
        raise BadFile(f"{path}: stamp {stamps_s[k]:.6f} of row {k + 1} is not later than the one "
                      "before it; sort the rows by time")
    return stamps_s
