"""Where every pixel's surface point goes: with its part, into another camera."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from simbench.types import FrameTruth
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics


class PartMotions(NamedTuple):
    """How the parts move between two frames: M motions, of which number 0 is none."""

    number: Array     # (P + 1,) of each part's motion; the last, part −1, is the sky's: none
    H_world: Array    # (M, 4, 4): p_j = H p_i


def part_motions(truth_i: FrameTruth, truth_j: FrameTruth) -> PartMotions:
    """The motions of all parts from frame i to frame j."""
    moved = np.flatnonzero(np.any(truth_i.T_world_part != truth_j.T_world_part, axis=(-2, -1)))
    number = np.zeros(len(truth_i.T_world_part) + 1, np.int32)
    number[moved] = 1 + np.arange(len(moved))
    H_world = truth_j.T_world_part[moved] @ se3.inverse(truth_i.T_world_part[moved])
    return PartMotions(number, np.concatenate([np.eye(4)[None], H_world]))


def into_camera(truth_i: FrameTruth, truth_j: FrameTruth, motions: PartMotions,
                intrinsics: Intrinsics) -> tuple[Array, Array]:
    """A (M, 3, 3), b (M, 3): with p = (u, v, 1), z_j p_j = z_i A p_i + b for each motion.

    A = K R K⁻¹ and b = K t of the camera's and the part's motion together.
    """
    K = intrinsics.matrix
    T_j_i = se3.inverse(truth_j.T_world_camera) @ motions.H_world @ truth_i.T_world_camera
    return K @ T_j_i[:, :3, :3] @ np.linalg.inv(K), T_j_i[:, :3, 3] @ K.T


def scene_flow(truth_i: FrameTruth, motions: PartMotions, intrinsics: Intrinsics) -> Array:
    """(H, W, 3) float32 motion in the world, in metres, of frame i's surface points."""
    # p_j − p_i = (H − 1) T_world_camera z K⁻¹ (u, v, 1)
    change = (motions.H_world - np.eye(4)) @ truth_i.T_world_camera
    A = change[:, :3, :3] @ np.linalg.inv(intrinsics.matrix)
    return _of_moved_pixels(truth_i.depth_m, truth_i.part_id, motions.number, A,
                            np.ascontiguousarray(change[:, :3, 3]))


@numba.njit(cache=True)
def _of_moved_pixels(depth: Array, part: Array, number: Array, A: Array, b: Array) -> Array:
    """(H, W, 3) float32: z A (u, v, 1) + b of the pixels whose motion is not number 0."""
    height, width = part.shape
    flow = np.zeros((height, width, 3), np.float32)
    for row in range(height):
        for column in range(width):
            m = number[part[row, column]]
            if m > 0:
                for axis in range(3):
                    flow[row, column, axis] = b[m, axis] + depth[row, column] * (
                        A[m, axis, 0] * column + A[m, axis, 1] * row + A[m, axis, 2])
    return flow
