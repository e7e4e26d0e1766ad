"""ORB points spread over the image and the pyramid."""

from __future__ import annotations

import cv2
import numba
import numpy as np

from slam.dpl.borders import depth_off_borders
from slam.dpl.config import DepthConfig, OrbConfig
from slam.dpl.fast import BORDER_PX, PADDING_PX, FastDetector
from slam.dpl.features import KeyPoints
from slam.geometry.arrays import Array

_OVERSAMPLED = 3     # candidates for each point that is kept
_FILL = 1.6          # cells for each point that is kept: many cells stay empty
_RADIUS = 15         # px of the disc that tells a point's angle


def _half_widths() -> Array:
    """(2 _RADIUS + 1,) of the disc in each of its rows, as many pixels high as wide everywhere."""
    off = np.arange(_RADIUS + 1)
    width = np.rint(np.sqrt(_RADIUS**2 - off**2)).astype(np.int64)
    height = np.array([off[width >= v].max() for v in off])
    half = np.maximum(width, height)
    return np.concatenate([half[:0:-1], half])


_HALF_WIDTHS = _half_widths()


class OrbDetector:
    """Detects many corners, keeps the best of each cell, describes those."""

    def __init__(self, config: OrbConfig, depth: DepthConfig | None = None) -> None:
        self.config, self.depth = config, DepthConfig() if depth is None else depth
        self._corners = FastDetector(config, _OVERSAMPLED * config.count)
        self._orb = cv2.ORB_create(nlevels=1, edgeThreshold=BORDER_PX)   # of one level at a time

    def __call__(self, gray: Array, depth_m: Array | None = None) -> KeyPoints:
        """The points of an image (H, W) uint8; depth is read from (H, W), metres."""
        padded = [cv2.copyMakeBorder(image, *(4 * [PADDING_PX]), cv2.BORDER_REFLECT_101)
                  for image in pyramid(gray, self.config.levels, self.config.scale)]
        found = self._corners(padded)
        uv = found.at * self.config.scale ** found.level.astype(np.float64)[:, None]
        keep = spread(uv, found.response, gray.shape, self.config.count)
        uv, at, level = uv[keep], found.at[keep], found.level[keep]
        angle = np.zeros(len(keep))
        descriptor = np.zeros((len(keep), 32), np.uint8)
        for number, image in enumerate(padded):
            mine = level == number              # they stand together
            if mine.any():
                angle[mine] = angles_deg(image, at[mine] + PADDING_PX)
                descriptor[mine] = self._describe(image, at[mine], angle[mine])
        depth = np.zeros(len(uv)) if depth_m is None else depth_off_borders(
            depth_m, uv, self.config.scale ** level.astype(np.float64),
            self.depth.inverse_depth_sigma)
        return KeyPoints(uv, level, angle, descriptor, depth)

    def _describe(self, padded: Array, at: Array, angle_deg: Array) -> Array:
        """(N, 32) uint8 of points at pixels (N, 2) of a level, all off its border."""
        points = [cv2.KeyPoint(u, v, 2.0 * _RADIUS + 1.0, angle) for (u, v), angle in zip(
            at.astype(np.float64).tolist(), angle_deg.tolist(), strict=True)]
        image = padded[PADDING_PX:-PADDING_PX, PADDING_PX:-PADDING_PX]
        return np.asarray(self._orb.compute(image, points)[1])


def pyramid(gray: Array, levels: int, scale: float) -> list[Array]:
    """An image (H, W) uint8 and smaller ones, each made of the one before."""
    out = [gray]
    for level in range(1, levels):
        size = [max(round(n / scale**level), 1) for n in gray.shape[::-1]]
        out.append(np.asarray(cv2.resize(out[-1], size, interpolation=cv2.INTER_LINEAR_EXACT)))
    return out


@numba.njit(cache=True, nogil=True)
def _moments(image, at):  # type: ignore[no-untyped-def]
    """(N, 2) of the grey levels over discs around pixels (N, 2): in u and in v."""
    out = np.zeros((len(at), 2))
    for n in range(len(at)):
        u, v, in_u, in_v = at[n, 0], at[n, 1], np.int64(0), np.int64(0)
        for y in range(-_RADIUS, _RADIUS + 1):
            row, half = np.int64(0), _HALF_WIDTHS[y + _RADIUS]
            for x in range(-half, half + 1):
                value = np.int64(image[v + y, u + x])
                row += value
                in_u += x * value
            in_v += y * row
        out[n, 0], out[n, 1] = in_u, in_v
    return out


def angles_deg(image: Array, at: Array) -> Array:
    """(N,) in [0, 360): from pixels (N, 2) to the centre of mass of the grey levels around."""
    moments = _moments(image, at)
    return np.asarray(np.degrees(np.arctan2(moments[:, 1], moments[:, 0])) % 360.0)


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
    strongest_first = np.argsort(-response, kind="stable")
    rank = _ranks(cell, strongest_first)
    kept = strongest_first[np.argsort(rank[strongest_first], kind="stable")[:count]]
    return np.sort(kept)


@numba.njit(cache=True, nogil=True)
def _ranks(cell, order):  # type: ignore[no-untyped-def]
    """(N,) how many of the same cell come before each, in this order."""
    taken = np.zeros(cell.max() + 1, np.int64)
    rank = np.empty(len(cell), np.int64)
    for n in order:
        rank[n] = taken[cell[n]]
        taken[cell[n]] += 1
    return rank
