"""ORB points spread over the image and the pyramid."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from slam.dpl.config import OrbConfig
from slam.dpl.features import KeyPoints
from slam.frontend.sampling import depth_at
from slam.geometry.arrays import Array

_OVERSAMPLED = 3     # candidates for each point that is kept
_BORDER_PX = 12      # cv2 mirrors the image where a patch reaches beyond its border
_FILL = 1.6          # cells for each point that is kept: many cells stay empty


class OrbDetector:
    """Detects many corners, keeps the best of each cell, describes those."""

    def __init__(self, config: OrbConfig) -> None:
        self.config = config
        self._orb = cv2.ORB_create(
            nfeatures=_OVERSAMPLED * config.count, scaleFactor=config.scale,
            nlevels=config.levels, fastThreshold=config.fast_threshold,
            edgeThreshold=_BORDER_PX)

    def __call__(self, gray: Array, depth_m: Array | None = None) -> KeyPoints:
        """The points of an image (H, W) uint8; depth is read from (H, W), metres."""
        found = self._orb.detect(gray)
        keep = spread(_positions(found), np.array([k.response for k in found]), gray.shape,
                      self.config.count)
        kept, descriptor = self._orb.compute(gray, [found[i] for i in keep])
        uv = _positions(kept)
        if descriptor is None:
            descriptor = np.zeros((0, 32), np.uint8)
        depth = np.zeros(len(uv)) if depth_m is None else depth_at(depth_m, uv)
        return KeyPoints(uv, np.array([k.octave for k in kept], dtype=np.int32),
                         np.array([k.angle for k in kept], dtype=np.float64), descriptor, depth)


def _positions(found: Sequence[cv2.KeyPoint]) -> Array:
    """(N, 2)"""
    return np.array(cv2.KeyPoint_convert(found), dtype=np.float64).reshape(-1, 2)


def spread(uv_px: Array, response: Array, shape: tuple[int, ...], count: int) -> Array:
    """Rows of at most `count` points: the strongest of every cell first, then the second ones.

    Args:
        uv_px: (N, 2).
        response: (N,) the greater, the better.
    """
    if len(uv_px) <= count:
        return np.arange(len(uv_px))
    side = max(np.sqrt(shape[0] * shape[1] / (_FILL * count)), 1.0)
    columns = int(shape[1] / side) + 1
    cell = (uv_px[:, 1] / side).astype(np.int64) * columns + (uv_px[:, 0] / side).astype(np.int64)
    order = np.lexsort((-response, cell))
    rank = np.arange(len(order)) - np.searchsorted(cell[order], cell[order], side="left")
    best = np.lexsort((-response[order], rank))[:count]
    return np.sort(order[best])
