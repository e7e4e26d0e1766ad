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

from simbench.truth.motion import PartMotions, into_camera
from simbench.truth.rays import RayCaster
from simbench.truth.surface import TOLERANCE_RELATIVE, Surface
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_WELL = 2e-3       # and at least this share of the distance


class Followed(NamedTuple):
    """On the pixels of frame i."""

    flow_px: Array    # (H, W, 2) float32; 0 where not `ahead`
    ahead: Array      # (H, W) bool: a surface is seen, and comes to lie in front of camera j
    inside: Array     # (H, W) bool: and within the image of j
    hidden: Array     # (H, W) bool: and behind something there


def follow(seen_i: Surface, seen_j: Surface, motions: PartMotions, intrinsics: Intrinsics,
           caster: RayCaster) -> Followed:
    """Follow the surface points of frame i, which move as `motions` says, to frame j."""
    part_id = seen_i.truth.part_id
    flow = np.zeros((*part_id.shape, 2), np.float32)
    ahead, inside, hidden = (np.zeros(part_id.shape, bool) for _ in range(3))
    A, b = into_camera(seen_i.truth, seen_j.truth, motions, intrinsics)
    pixel, uvz = _project(seen_i.truth.depth_m, part_id, motions.number, A, b,
                          seen_j.inverse_depth, seen_j.cell_part, 1.0 + TOLERANCE_RELATIVE,
                          flow, ahead, inside)
    covered = _well_covered(uvz, seen_j)
    asked = ~covered
    covered[asked] = caster.hides(seen_j.truth, intrinsics)(uvz[asked])
    hidden.ravel()[pixel] = covered
    return Followed(flow, ahead, inside, hidden)


@numba.njit(cache=True)
def _project(depth: Array, part: Array, number: Array, A: Array, b: Array, inverse_depth: Array,
             cell_part: Array, limit: float, flow: Array, ahead: Array, inside: Array
             ) -> tuple[Array, Array]:
    """Fill flow, ahead and inside; the pixels (N,) left open, and u, v, z (N, 3) of their points.

    Not left open are points that the four pixels of j around them show as their own part's plane,
    no nearer than `limit` times the point.
    """
    height, width = part.shape
    last = len(inverse_depth) - 1
    pixel, uvz = np.empty(height * width, np.int64), np.empty((height * width, 3))
    count = 0
    for row in range(height):
        for column in range(width):
            if part[row, column] < 0:
                continue
            m = number[part[row, column]]
            z_i = np.float64(depth[row, column])
            z = z_i * (A[m, 2, 0] * column + A[m, 2, 1] * row + A[m, 2, 2]) + b[m, 2]
            if not z > 0.0:
                continue
            ahead[row, column] = True
            u = (z_i * (A[m, 0, 0] * column + A[m, 0, 1] * row + A[m, 0, 2]) + b[m, 0]) / z
            v = (z_i * (A[m, 1, 0] * column + A[m, 1, 1] * row + A[m, 1, 2]) + b[m, 1]) / z
            flow[row, column, 0], flow[row, column, 1] = u - column, v - row
            if not (abs(u - 0.5 * (width - 1)) < 0.5 * width
                    and abs(v - 0.5 * (height - 1)) < 0.5 * height):
                continue
            inside[row, column] = True
            if min(u, v) >= 0.0:                     # outside of that there is no cell
                u0, v0 = int(u), int(v)
                cell = v0 * width + u0
                if cell_part[cell] == part[row, column]:
                    corner = np.float64(inverse_depth[cell])
                    inverse = corner + (u - u0) * (inverse_depth[min(cell + 1, last)] - corner)
                    inverse += (v - v0) * (inverse_depth[min(cell + width, last)] - corner)
                    if inverse * z <= limit:
                        continue
            pixel[count] = row * width + column
            uvz[count, 0], uvz[count, 1], uvz[count, 2] = u, v, z
            count += 1
    return pixel[:count], uvz[:count]


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
