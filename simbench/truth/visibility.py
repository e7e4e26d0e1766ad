"""What becomes of frame i's surface points in frame j: seen, hidden or outside the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simbench.truth.motion import PartMotion, Projection
from simbench.truth.rays import RayCaster
from simbench.types import FrameTruth
from slam.geometry.arrays import Array
from slam.types import Intrinsics

# Depth images are exact to 1e-4 m or 1e-4 of the distance; twice that is no occlusion.
_TOLERANCE_M = 2e-4
_TOLERANCE_RELATIVE = 2e-4
_STRIP_ROWS = 32   # worked on at a time: what lies between stays in the processor's cache
_NO_PART = -2      # a cell of four pixels that do not show one part


class Followed(NamedTuple):
    """On the pixels of frame i."""

    flow_px: Array    # (H, W, 2) float32; 0 where not `ahead`
    ahead: Array      # (H, W) bool: a surface is seen, and comes to lie in front of camera j
    inside: Array     # (H, W) bool: and within the image of j
    hidden: Array     # (H, W) bool: and behind something there


def follow(truth_i: FrameTruth, truth_j: FrameTruth, motions: list[PartMotion],
           intrinsics: Intrinsics, caster: RayCaster) -> Followed:
    """Follow the surface points of frame i, which move as `motions` says, to frame j.

    A point is visible without a ray when the four pixels of j around it show its own part, and
    the plane through them is no nearer than the point. All others are decided by rays.
    """
    height, width = truth_i.depth_m.shape
    projection = Projection(truth_i, truth_j, motions, intrinsics)
    cells = _plane_cells(truth_j)
    flow = np.empty((height, width, 2), np.float32)
    ahead, inside, hidden = (np.zeros((height, width), bool) for _ in range(3))
    doubtful, uvz_of_doubtful = [], []
    for start in range(0, height, _STRIP_ROWS):
        rows = slice(start, min(start + _STRIP_ROWS, height))
        part = truth_i.part_id[rows]
        uvz = projection.rows(rows)
        u, v, z = uvz
        np.logical_and(part >= 0, z > 0.0, out=ahead[rows])
        np.copyto(uvz, -1.0, where=~ahead[rows])
        np.subtract(u, np.arange(width), out=flow[rows, :, 0], casting="same_kind")
        np.subtract(v, np.arange(height)[rows, None], out=flow[rows, :, 1], casting="same_kind")
        within = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
        within &= ahead[rows]
        inside[rows] = within
        asked = np.flatnonzero(within & ~_surely_visible(part, uvz, within, cells))
        doubtful.append(asked + start * width)
        uvz_of_doubtful.append(uvz.reshape(3, -1)[:, asked])
    flow[~ahead] = 0.0
    hidden.ravel()[np.concatenate(doubtful)] = occluded_by_ray(
        np.concatenate(uvz_of_doubtful, axis=1).T, truth_j, intrinsics, caster)
    return Followed(flow, ahead, inside, hidden)


def occluded_by_ray(uvz: Array, truth: FrameTruth, intrinsics: Intrinsics,
                    caster: RayCaster) -> Array:
    """(N,) bool: something stands before points given as (N, 3) pixels and z-depth."""
    rays = np.array(uvz, np.float64)
    rays[:, 2] = 1.0
    to_world = truth.T_world_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix)
    caster.place(truth.T_world_part)
    hit_depth, _ = caster.cast(truth.T_world_camera[:3, 3], rays @ to_world.T)
    return hit_depth < uvz[:, 2] - np.maximum(_TOLERANCE_M, _TOLERANCE_RELATIVE * uvz[:, 2])


class _Cells(NamedTuple):
    """Cell (v, u) has the pixels (v, u) to (v + 1, u + 1) as its corners."""

    inverse_depth: Array   # (H * W,) float32 at (v, u)
    part: Array            # (H * W,) int32 that all corners show, as one plane; else _NO_PART


def _plane_cells(truth: FrameTruth) -> _Cells:
    part, depth = truth.part_id, truth.depth_m
    inverse = np.divide(np.float32(1.0), depth, where=depth > 0.0, out=np.zeros_like(depth))
    corner = part[:-1, :-1]
    alike = (corner == part[:-1, 1:]) & (corner == part[1:, :-1]) & (corner == part[1:, 1:])
    # Inverse depth is affine in the pixel on a plane.
    bend = inverse[:-1, :-1] - inverse[:-1, 1:]
    bend -= inverse[1:, :-1]
    bend += inverse[1:, 1:]
    alike &= np.abs(bend) <= _TOLERANCE_RELATIVE * inverse[:-1, :-1]
    plane = np.full(part.shape, _NO_PART, np.int32)
    np.copyto(plane[:-1, :-1], corner, where=alike)
    return _Cells(inverse.ravel(), plane.ravel())


def _surely_visible(part: Array, uvz: Array, inside: Array, cells: _Cells) -> Array:
    """(h, W) bool: the cell a point falls into shows its own part, as a plane behind the point."""
    width = part.shape[1]
    u, v = np.where(inside, uvz[:2], 0.0)
    in_a_cell = np.minimum(u, v) >= 0.0   # the image reaches half a pixel further
    u0, v0 = u.astype(np.intp), v.astype(np.intp)
    cell = v0 * width + u0
    corner = cells.inverse_depth.take(cell)
    surface = corner + (u - u0) * (cells.inverse_depth.take(cell + 1, mode="clip") - corner)
    surface += (v - v0) * (cells.inverse_depth.take(cell + width, mode="clip") - corner)
    surface *= uvz[2]
    in_a_cell &= surface <= 1.0 + _TOLERANCE_RELATIVE
    in_a_cell &= cells.part.take(cell) == part
    return in_a_cell
