"""FAST corners of every level of a pyramid, the best of each by Harris's measure, as in cv2's ORB.

FAST at a low threshold finds ten times the corners that are kept. Each level's threshold follows
the pictures instead; a level where it turns out to be too high is done again with the low one, so
that what is found does not depend on it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numba
import numpy as np

from slam.dpl.config import OrbConfig
from slam.geometry.arrays import Array

BORDER_PX = 12           # corners nearer to a level's border are dropped
PADDING_PX = 16          # by which levels are mirrored, for patches that reach beyond
_RANKED = 2              # corners for each that is kept, of which Harris's measure chooses
_WANTED = 2.3            # so many are asked of FAST
_LOWER = 0.85            # of a threshold that finds fewer
_HARRIS_RADIUS, _HARRIS_K = 3, 0.04


class Corners(NamedTuple):
    at: Array            # (N, 2) int64 pixels of their levels
    level: Array         # (N,) int32
    response: Array      # (N,) the greater, the better


class FastDetector:
    """Detects up to `count` corners, more on the finer levels."""

    def __init__(self, config: OrbConfig, count: int) -> None:
        self.lowest = config.fast_threshold
        self._counts = level_counts(count, config.levels, config.scale)
        self._thresholds = [config.fast_threshold] * config.levels
        self._fast = cv2.FastFeatureDetector_create()

    def __call__(self, padded: list[Array]) -> Corners:
        """The corners of a pyramid's levels, (H + 2 PADDING_PX, W + 2 PADDING_PX) uint8 each."""
        found = [self._of_level(level, image) for level, image in enumerate(padded)]
        return Corners(np.concatenate([at for at, _ in found]),
                       np.repeat(np.arange(len(found), dtype=np.int32),
                                 [len(at) for at, _ in found]),
                       np.concatenate([response for _, response in found]))

    def _of_level(self, level: int, padded: Array) -> tuple[Array, Array]:
        count = self._counts[level]
        at, score = self._detect(padded, self._thresholds[level])
        if len(at) < _RANKED * count and self._thresholds[level] > self.lowest:
            at, score = self._detect(padded, self.lowest)
        self._thresholds[level] = self._next_threshold(level, score, round(_WANTED * count))
        at = at[best(score, _RANKED * count)]
        response = _harris(padded, at + PADDING_PX)
        kept = best(response, count)
        return at[kept], response[kept]

    def _detect(self, padded: Array, threshold: int) -> tuple[Array, Array]:
        """Corners (N, 2) and the highest threshold (N,) at which each is one."""
        self._fast.setThreshold(threshold)
        image = padded[PADDING_PX:-PADDING_PX, PADDING_PX:-PADDING_PX]
        found = self._fast.detect(image)
        at = np.asarray(cv2.KeyPoint_convert(found), np.float64).reshape(-1, 2).astype(np.int64)
        inside = ((at >= BORDER_PX) & (at < np.array(image.shape[::-1]) - BORDER_PX)).all(axis=1)
        return at[inside], np.array([k.response for k in found])[inside]

    def _next_threshold(self, level: int, score: Array, wanted: int) -> int:
        """Where the next picture, if it is like this one, has as many corners as wanted."""
        if len(score) <= wanted:
            return max(int(_LOWER * self._thresholds[level]), self.lowest)
        return max(int(-np.partition(-score, wanted)[wanted]), self.lowest)


def level_counts(count: int, levels: int, scale: float) -> list[int]:
    """How many corners each level may keep, as many for its width as any other."""
    share = (1.0 / scale) ** np.arange(levels)
    counts = [round(n) for n in count * share / share.sum()]
    return [*counts[:-1], max(count - sum(counts[:-1]), 0)]


def best(score: Array, count: int) -> Array:
    """Rows of the highest `count` scores (N,), and of those equal to the last of them."""
    if len(score) <= count:
        return np.arange(len(score))
    if count == 0:
        return np.zeros(0, np.int64)
    return np.flatnonzero(score >= -np.partition(-score, count - 1)[count - 1])


@numba.njit(cache=True, nogil=True)
def _harris(image, at):  # type: ignore[no-untyped-def]
    """(N,) det − k trace² of the gradients' products, summed around pixels (N, 2)."""
    out = np.empty(len(at))
    r = _HARRIS_RADIUS
    for n in range(len(at)):
        uu, vv, uv = np.int64(0), np.int64(0), np.int64(0)
        for y in range(at[n, 1] - r, at[n, 1] + r + 1):
            for x in range(at[n, 0] - r, at[n, 0] + r + 1):
                a, b, c = (np.int64(image[y - 1, x - 1]), np.int64(image[y - 1, x]),
                           np.int64(image[y - 1, x + 1]))
                d, f = np.int64(image[y, x - 1]), np.int64(image[y, x + 1])
                g, h, i = (np.int64(image[y + 1, x - 1]), np.int64(image[y + 1, x]),
                           np.int64(image[y + 1, x + 1]))
                du, dv = 2 * (f - d) + c - a + i - g, 2 * (h - b) + g - a + i - c
                uu += du * du
                vv += dv * dv
                uv += du * dv
        trace = float(uu) + float(vv)
        out[n] = float(uu) * float(vv) - float(uv) * float(uv) - _HARRIS_K * trace * trace
    return out
