"""What becomes of frame i's surface points in frame j: seen, hidden or outside the image.

Most points are visible beyond doubt: the four pixels of j around them show their own part, as one
plane no nearer than the point. Most others are hidden beyond doubt: the four show something well
before them. Both err only where something thinner than a pixel slips between the four. A ray
decides what is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from simbench.truth.motion import PartMotion, Projection
from simbench.truth.rays import RayCaster
from simbench.truth.surface import TOLERANCE_RELATIVE, Surface
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_WELL = 2e-3       # and at least this share of the distance
_STRIP_ROWS = 32   # worked on at a time: what lies between stays in the processor's cache


class Followed(NamedTuple):
    """On the pixels of frame i."""

    flow_px: Array    # (H, W, 2) float32; 0 where not `ahead`
    ahead: Array      # (H, W) bool: a surface is seen, and comes to lie in front of camera j
    inside: Array     # (H, W) bool: and within the image of j
    hidden: Array     # (H, W) bool: and behind something there


def follow(seen_i: Surface, seen_j: Surface, motions: list[PartMotion], intrinsics: Intrinsics,
           caster: RayCaster) -> Followed:
    """Follow the surface points of frame i, which move as `motions` says, to frame j."""
    part_id = seen_i.truth.part_id
    height, width = part_id.shape
    projection = Projection(seen_i.truth, seen_j.truth, motions, intrinsics)
    flow = np.empty((height, width, 2), np.float32)
    ahead, inside, hidden = (np.zeros((height, width), bool) for _ in range(3))
    across, downward = np.arange(float(width)), np.arange(float(height))[:, None]
    open_pixels, open_uvz = [], []
    for start in range(0, height, _STRIP_ROWS):
        rows = slice(start, min(start + _STRIP_ROWS, height))
        uvz = projection.rows(rows)
        u, v, z = uvz
        np.logical_and(part_id[rows] >= 0, z > 0.0, out=ahead[rows])
        if not ahead[rows].all():
            np.copyto(uvz, -1.0, where=~ahead[rows])   # which lies outside of the image
        flow[rows, :, 0] = u - across
        flow[rows, :, 1] = v - downward[rows]
        within = np.abs(u - 0.5 * (width - 1)) < 0.5 * width
        within &= np.abs(v - 0.5 * (height - 1)) < 0.5 * height
        inside[rows] = within
        left_open = np.flatnonzero(within & ~_on_its_own_plane(part_id[rows], uvz, within, seen_j))
        open_pixels.append(left_open + start * width)
        open_uvz.append(uvz.reshape(3, -1)[:, left_open])
    flow[~ahead] = 0.0
    pixel, uvz = np.concatenate(open_pixels), np.concatenate(open_uvz, axis=1).T
    covered = _well_covered(uvz, seen_j)
    asked = ~covered
    covered[asked] = caster.hides(seen_j.truth, intrinsics)(uvz[asked])
    hidden.ravel()[pixel] = covered
    return Followed(flow, ahead, inside, hidden)


def _on_its_own_plane(part: Array, uvz: Array, inside: Array, seen: Surface) -> Array:
    """(h, W) bool: the four pixels around show the point's part as a plane not before the point."""
    return _planes_seen(part, uvz, inside, seen.inverse_depth, seen.cell_part,
                        1.0 + TOLERANCE_RELATIVE)


@numba.njit(cache=True)
def _planes_seen(part: Array, uvz: Array, inside: Array, inverse_depth: Array, cell_part: Array,
                 limit: float) -> Array:
    height, width = part.shape
    last = len(inverse_depth) - 1
    visible = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            u, v = uvz[0, row, column], uvz[1, row, column]
            if not inside[row, column] or min(u, v) < 0.0:   # outside of that there is no cell
                continue
            u0, v0 = int(u), int(v)
            cell = v0 * width + u0
            if cell_part[cell] != part[row, column]:
                continue
            corner = inverse_depth[cell]
            inverse = (u - u0) * np.float64(inverse_depth[min(cell + 1, last)] - corner)
            inverse += (v - v0) * np.float64(inverse_depth[min(cell + width, last)] - corner)
            inverse += corner
            visible[row, column] = inverse * uvz[2, row, column] <= limit
    return visible


def _well_covered(uvz: Array, seen: Surface) -> Array:
    """(N,) bool: the four pixels around a point show one part, well before it.

    Well before: twice as far as the surface there reaches from its nearest to its farthest pixel.
    """
    height, width = seen.truth.depth_m.shape
    u, v, z = uvz.T
    certain = (np.minimum(u, v) >= 0.0) & (u < width - 1) & (v < height - 1)
    u0, v0 = np.where(certain, (u, v), 0.0).astype(np.intp)
    corners = v0 * width + u0 + np.array([0, 1, width, width + 1])[:, None]
    part = seen.truth.part_id.ravel().take(corners)
    certain &= np.all(part == part[0], axis=0)
    inverse = seen.inverse_depth.take(corners).astype(np.float64)
    farthest, nearest = inverse.min(axis=0), inverse.max(axis=0)
    return certain & (farthest - 1.0 / z > 2.0 * (nearest - farthest) + _WELL / z)
