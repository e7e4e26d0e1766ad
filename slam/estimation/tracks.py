"""Tracks of corners and segments over the frames: struct of arrays, replaced each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array
from slam.types import Points2D, Segments2D


@dataclass(frozen=True, slots=True)
class TrackNumbers:
    """Hands out numbers that are never used twice."""

    next_id: int = 0

    def take(self, count: int) -> tuple[Array, TrackNumbers]:
        ids = np.arange(self.next_id, self.next_id + count, dtype=np.int64)
        return ids, TrackNumbers(self.next_id + count)


def empty_points() -> Points2D:
    return Points2D(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int32))


def empty_segments() -> Segments2D:
    return Segments2D(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros(0, np.int64),
                      np.zeros(0, np.int32))
