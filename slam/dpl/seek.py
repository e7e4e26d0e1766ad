"""Landmarks sought by their patches where no corner was found that looks like them.

A detector finds but a part of the corners of one picture in the next. A landmark whose place is
predicted to a fraction of a pixel needs none: its patch is aligned there.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from slam.dpl.culling import StillGround
from slam.dpl.landmarks import Landmarks
from slam.dpl.picture import Picture
from slam.frontend.sampling import inside, nearest
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import project
from slam.types import Intrinsics

_SIGMAS = 5.0            # of the inverse depth, by which what hides a landmark is nearer,
_SAME = 0.03             # and this share of it besides: surfaces are steep


class Sought(NamedTuple):
    rows: Array          # (M,) landmarks
    uv_px: Array         # (M, 2) where they should be


def to_seek(points: Landmarks, rows: Array, beside_px: Array, T_world_camera: Array,
            camera: Intrinsics, picture: Picture, ground: StillGround | None,
            inverse_depth_sigma: float, least_px: float) -> Sought:
    """Those of the landmarks `rows` that nothing hides and nothing near moves, best known first.

    Patches that overlap tell the same twice: none is within `least_px` of another one, or of
    `beside_px` (P, 2), where landmarks were found already.

    Args:
        ground: where nothing moves; None: everywhere.
        inverse_depth_sigma: 1/m, of measured depth.
    """
    rows = rows[np.argsort(-points.found[rows], kind="stable")]
    xyz = se3.transform_points(se3.inverse(T_world_camera), points.xyz[rows, 0])
    uv = project(camera, xyz)
    seen = np.flatnonzero(open_to_view(uv, xyz[:, 2], picture.depth_m, inverse_depth_sigma))
    if ground is not None:
        seen = seen[ground.holds(uv[seen])]
    alone = apart(np.concatenate([beside_px, uv[seen]]), picture.gray.shape, least_px)
    seen = seen[alone[len(beside_px):]]
    return Sought(rows[seen], uv[seen])


def open_to_view(uv_px: Array, z_m: Array, depth_m: Array, inverse_depth_sigma: float) -> Array:
    """(N,) bool: landmarks expected at pixels (N, 2) and depths (N,) where such a depth is seen.

    Args:
        depth_m: (H, W), 0 where unknown: there nothing speaks against a landmark.
        inverse_depth_sigma: 1/m.
    """
    with np.errstate(invalid="ignore"):
        there = np.asarray(inside(uv_px, depth_m.shape) & (z_m > 0))
    measured = nearest(depth_m, uv_px)
    known = there & (measured > 0)
    rho = 1.0 / np.where(known, z_m, 1.0)
    gap = np.abs(rho - 1.0 / np.where(known, measured, 1.0))
    return np.asarray(there & (~known | (gap < _SIGMAS * inverse_depth_sigma + _SAME * rho)))


def apart(uv_px: Array, shape: tuple[int, ...], least_px: float) -> Array:
    """(N,) bool: positions (N, 2) in an image that are not within `least_px` of an earlier one
    that is kept; none outside the image is.
    """
    return np.asarray(_apart(np.ascontiguousarray(uv_px), shape[0], shape[1], least_px))


@numba.njit(cache=True, nogil=True)
def _apart(uv, height, width, least):  # type: ignore[no-untyped-def]
    kept = np.zeros(len(uv), np.bool_)
    side = least / np.sqrt(2.0)          # no two that are kept share such a cell
    holder = np.full((int(height / side) + 5, int(width / side) + 5), -1)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        row, column = int((v + 0.5) / side) + 2, int((u + 0.5) / side) + 2
        free = True
        for i in range(row - 2, row + 3):
            for j in range(column - 2, column + 3):
                m = holder[i, j]
                if m >= 0 and (u - uv[m, 0]) ** 2 + (v - uv[m, 1]) ** 2 < least * least:
                    free = False
        if free:
            kept[n] = True
            holder[row, column] = n
    return kept
