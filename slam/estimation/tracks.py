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


def join_points(first: Points2D, second: Points2D) -> Points2D:
    return Points2D(np.concatenate([first.uv_px, second.uv_px]),
                    np.concatenate([first.depth_m, second.depth_m]),
                    np.concatenate([first.track_id, second.track_id]),
                    np.concatenate([first.instance_id, second.instance_id]))


def join_segments(first: Segments2D, second: Segments2D) -> Segments2D:
    return Segments2D(np.concatenate([first.endpoints_px, second.endpoints_px]),
                      np.concatenate([first.depth_m, second.depth_m]),
                      np.concatenate([first.track_id, second.track_id]),
                      np.concatenate([first.instance_id, second.instance_id]))
