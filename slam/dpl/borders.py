"""Points whose pixel shows what lies behind: beside the border of a nearer surface.

A corner on a border belongs to the nearer surface and moves with it, but its pixel may lie on the
far side and have its depth. Half of the corners on borders do, all err to one side, and so
lengths come out too long.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.frontend.sampling import depth_at
from slam.geometry.arrays import Array

_REACH_PX = 3.0          # of a corner on the finest level: FAST's circle
_SAMPLES = 2             # to each side of a point
_STEEPER = 2.0           # on a plane inverse depth rises to one side as it falls to the other
_SAME = 0.01             # of the inverse depth: less is no border
_SIGMAS = 3.0            # of a pixel, though means of nine are compared: noise is no border
_QUANTILE, _AT_QUANTILE = 0.8, 1.2816    # of |x|, and where it lies for x of variance 1
_ROW_STEP = 4            # rows that noise is read from


def behind_border(depth_m: Array, uv_px: Array, reach_px: Array, inverse_depth_sigma: float
                  ) -> Array:
    """(N,) bool: beside which points (N, 2) a nearer surface begins.

    Args:
        depth_m: (H, W) float32, 0 where there is none.
        reach_px: (N,) how far a point's own corner reaches.
        inverse_depth_sigma: 1/m, of a pixel, at most: less where the image itself shows less, as
            slight reliefs of far walls would hide in it.
    """
    sigma = min(inverse_depth_sigma, noise_of_inverse_depth(depth_m))
    return np.asarray(_behind(depth_m, uv_px, reach_px, sigma))


def noise_of_inverse_depth(depth_m: Array) -> float:
    """Standard deviation (1/m) of a pixel, by second differences along rows; inf where unknown.

    Inverse depth rises evenly along a plane. No median: quantised depth has none in most places.
    """
    rows = depth_m[::_ROW_STEP]
    known = (rows[:, 2:] > 0) & (rows[:, 1:-1] > 0) & (rows[:, :-2] > 0)
    rho = 1.0 / np.where(rows > 0, rows, 1.0)
    bend = np.abs(rho[:, 2:] - 2.0 * rho[:, 1:-1] + rho[:, :-2])[known]
    if not len(bend):
        return np.inf
    return float(np.quantile(bend, _QUANTILE) / (_AT_QUANTILE * np.sqrt(6.0)))


def depth_off_borders(depth_m: Array, uv_px: Array, scale: Array, inverse_depth_sigma: float
                      ) -> Array:
    """(N,) z-depth of points (N, 2); 0 where unknown, or of what the point does not lie on.

    Args:
        depth_m: (H, W) float32, 0 where there is none.
        scale: (N,) of each point's pyramid level, in pixels of the finest one.
        inverse_depth_sigma: 1/m, of a pixel.
    """
    hidden = behind_border(depth_m, uv_px, _REACH_PX * scale, inverse_depth_sigma)
    return np.where(hidden, 0.0, depth_at(depth_m, uv_px))


@numba.njit(cache=True, nogil=True)
def _behind(depth, uv, reach, sigma):  # type: ignore[no-untyped-def]
    out = np.zeros(len(uv), np.bool_)
    for n in range(len(uv)):
        own = _mean_inverse(depth, uv[n, 0], uv[n, 1])
        if own <= 0.0:
            continue
        nearest, farthest = own, own
        step = reach[n] / _SAMPLES
        for i in range(-_SAMPLES, _SAMPLES + 1):
            for j in range(-_SAMPLES, _SAMPLES + 1):
                rho = _mean_inverse(depth, uv[n, 0] + step * j, uv[n, 1] + step * i)
                if rho > 0.0:
                    nearest, farthest = max(nearest, rho), min(farthest, rho)
        out[n] = nearest - own > _STEEPER * (own - farthest) + _SAME * own + _SIGMAS * sigma
    return out


@numba.njit(cache=True, nogil=True, inline="always")
def _mean_inverse(depth, u, v):  # type: ignore[no-untyped-def]
    """Mean inverse depth of the 3×3 pixels around a position; 0 where one has none."""
    column, row = int(np.rint(u)), int(np.rint(v))
    if not (1 <= column < depth.shape[1] - 1 and 1 <= row < depth.shape[0] - 1):
        return 0.0
    total = 0.0
    for y in range(row - 1, row + 2):
        for x in range(column - 1, column + 2):
            if not depth[y, x] > 0:
                return 0.0
            total += 1.0 / depth[y, x]
    return total / 9.0
