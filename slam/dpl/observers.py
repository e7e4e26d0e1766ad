"""Which keyframes see each landmark: the inverse of what each keyframe says it sees."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

_NONE = -1


class Observers:
    """Numbers of keyframes by row of the landmark, each once, in no particular order."""

    def __init__(self) -> None:
        self._number = np.full((1024, 4), _NONE, np.int64)
        self._count = np.zeros(1024, np.int64)

    def add(self, rows: Array, keyframe: int) -> None:
        """A keyframe sees the landmarks `rows` (N,), each named once, none seen by it so far."""
        if not len(rows):
            return
        self._grow(int(rows.max()) + 1)
        at = self._count[rows]
        if at.max() >= self._number.shape[1]:
            self._number = np.concatenate([self._number, np.full_like(self._number, _NONE)], axis=1)
        self._number[rows, at] = keyframe
        self._count[rows] = at + 1

    def remove(self, rows: Array, keyframe: int) -> None:
        """It sees them no more (N,), each of which it saw; the last observer takes its place."""
        if not len(rows):
            return
        at = np.argmax(self._number[rows] == keyframe, axis=1)
        last = self._count[rows] - 1
        self._number[rows, at] = self._number[rows, last]
        self._number[rows, last] = _NONE
        self._count[rows] = last

    def count(self, rows: Array) -> Array:
        """(N,) how many keyframes see each landmark."""
        there = rows < len(self._count)
        return np.where(there, self._count[np.where(there, rows, 0)], 0)

    def of(self, rows: Array) -> Array:
        """(M,) the keyframes that see landmarks (N,): one once for each of them that it sees."""
        numbers = self._number[rows[rows < len(self._count)]]
        return numbers[numbers != _NONE]

    def _grow(self, size: int) -> None:
        held = len(self._count)
        if size <= held:
            return
        more = max(2 * held, size) - held
        self._number = np.concatenate([
            self._number, np.full((more, self._number.shape[1]), _NONE)])
        self._count = np.concatenate([self._count, np.zeros(more, np.int64)])
