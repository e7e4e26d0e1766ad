"""What becomes of carried points in another frame: seen, hidden or outside the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simbench.truth.motion import Carried
from simbench.truth.rays import RayCaster
from simbench.types import FrameTruth
from slam.geometry.arrays import Array
from slam.types import Intrinsics

# The depth image is exact to 1e-4 m or 1e-4 of the distance; twice that is no occlusion.
HIT_TOLERANCE_M = 2e-4
HIT_TOLERANCE_RELATIVE = 2e-4
_NO_PART = -2   # a cell of four pixels that do not show one part


class Fates(NamedTuple):
    """All (H, W) bool, on the pixels of frame i."""

    ahead: Array      # a surface is seen, and comes to lie in front of camera j
    inside: Array     # and within the image of j
    hidden: Array     # and behind something there


def fates(truth_i: FrameTruth, carried: Carried, truth_j: FrameTruth, intrinsics: Intrinsics,
          caster: RayCaster) -> Fates:
    """Decide for each pixel of frame i what camera j sees of it.

    A point is visible without a ray when the four pixels of j around it show its own part, and
    the plane through them is no nearer than the point. All others are decided by rays.
    """
    ahead = (truth_i.part_id >= 0) & (carried.depth_m > 0.0)
    inside = ahead & (carried.u_px >= -0.5) & (carried.u_px < intrinsics.width - 0.5)
    inside &= (carried.v_px >= -0.5) & (carried.v_px < intrinsics.height - 0.5)
    doubtful = inside & ~_surely_visible(truth_i.part_id, carried, truth_j, inside)
    hidden = np.zeros_like(inside)
    if doubtful.any():
        uvz = np.stack([c[doubtful] for c in carried], axis=-1)
        hidden[doubtful] = occluded_by_ray(uvz, truth_j, intrinsics, caster)
    return Fates(ahead, inside, hidden)


def occluded_by_ray(uvz: Array, truth: FrameTruth, intrinsics: Intrinsics,
                    caster: RayCaster) -> Array:
    """(N,) bool: something stands before points given as (N, 3) pixels and z-depth."""
    rays = np.empty_like(uvz)
    rays[:, :2] = uvz[:, :2]
    rays[:, 2] = 1.0
    to_world = truth.T_world_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix)
    caster.place(truth.T_world_part)
    hit_depth, _ = caster.cast(truth.T_world_camera[:3, 3], rays @ to_world.T)
    return hit_depth < uvz[:, 2] - np.maximum(HIT_TOLERANCE_M, HIT_TOLERANCE_RELATIVE * uvz[:, 2])


def _surely_visible(part: Array, carried: Carried, truth_j: FrameTruth, inside: Array) -> Array:
    """(H, W) bool: the cell of four pixels it falls into shows its own part, as a plane, behind it.

    Inverse depth is affine in the pixel on a plane.
    """
    width = part.shape[1]
    inverse, plane_of = _plane_cells(truth_j)
    u, v = np.where(inside, carried.u_px, 0.0), np.where(inside, carried.v_px, 0.0)
    within = np.minimum(u, v) >= 0.0   # in the half pixel outside of that there is no cell
    u0, v0 = u.astype(np.int32), v.astype(np.int32)
    cell = v0 * np.int32(width) + u0
    fu, fv = (u - u0).astype(np.float32), (v - v0).astype(np.float32)
    corner = inverse.take(cell)
    right, below = inverse.take(cell + 1, mode="clip"), inverse.take(cell + width, mode="clip")
    surface = corner + fu * (right - corner) + fv * (below - corner)
    behind = surface * carried.depth_m <= 1.0 + HIT_TOLERANCE_RELATIVE
    return within & behind & (plane_of.take(cell) == part)


def _plane_cells(truth: FrameTruth) -> tuple[Array, Array]:
    """(H, W) float32 inverse depth, and (H, W) int32 part of each cell whose four pixels are a plane.

    Cell (v, u) has the corners (v, u) to (v + 1, u + 1).
    """
    part, depth = truth.part_id, truth.depth_m
    inverse = np.divide(np.float32(1.0), depth, where=depth > 0.0, out=np.zeros_like(depth))
    corner = part[:-1, :-1]
    alike = (corner == part[:-1, 1:]) & (corner == part[1:, :-1]) & (corner == part[1:, 1:])
    bend = inverse[:-1, :-1] - inverse[:-1, 1:]
    bend -= inverse[1:, :-1]
    bend += inverse[1:, 1:]
    alike &= np.abs(bend) <= HIT_TOLERANCE_RELATIVE * inverse[:-1, :-1]
    plane_of = np.full(part.shape, _NO_PART, np.int32)
    np.copyto(plane_of[:-1, :-1], corner, where=alike)
    return inverse, plane_of
