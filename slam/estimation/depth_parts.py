"""What the depths of one part of an image err by together, from one frame to the next.

Stereo matching smooths: pixels of one thing are too near or too far alike, and no number of them
averages that out. The static world tells how large such errors are.
"""

from __future__ import annotations

import numpy as np

from slam.estimation.tiles import tiles
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import PointMatches
from slam.spread import sigma_of_distances
from slam.types import Intrinsics

_PARTS = (4, 8)          # rows and columns
_LEAST = 10              # points of a part from which its median may be read
_LEAST_PARTS = 8
_MEDIAN_OVER_MEAN = 1.2533   # standard deviations of the two, of Gaussian noise


def common_depth_error(points: PointMatches, T_a_b: Array, camera: Intrinsics) -> float:
    """Standard deviation, 1/m, of what a part's inverse depths in b have in common beside noise.

    Args:
        points: those of group 0 with depth in b count.
        T_a_b: (4, 4) the static world's pose.
    Returns:
        nan where too few parts can be read.
    """
    chosen = np.flatnonzero((points.group == 0) & np.isfinite(points.rho_sigma_b)
                            & (points.rho_a > 0))
    uv = points.uv_a[chosen]
    xyz_a = pinhole.back_project(camera, uv, 1.0 / points.rho_a[chosen])
    depth = se3.transform_points(se3.inverse(T_a_b), xyz_a)[:, 2]
    residual = points.rho_b[chosen] - 1.0 / np.maximum(depth, 1e-6)
    part = tiles(uv, points.group[chosen], camera, _PARTS)
    of_part = [residual[part == k] for k in np.flatnonzero(
        np.bincount(part, minlength=_PARTS[0] * _PARTS[1]) >= _LEAST)]
    if len(of_part) < _LEAST_PARTS:
        return float("nan")
    middle = np.array([np.median(r) for r in of_part])
    expected = np.array([_MEDIAN_OVER_MEAN * sigma_of_distances(r - m) / np.sqrt(len(r))
                         for r, m in zip(of_part, middle, strict=True)])
    excess = sigma_of_distances(middle) ** 2 - np.mean(expected**2)
    return float(np.sqrt(max(excess, 0.0)))
