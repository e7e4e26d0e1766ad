"""Where every pixel's surface point goes: with its part, into another camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from simbench.types import FrameTruth
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics


class PartMotion(NamedTuple):
    """One part that is seen in a frame and moves until another."""

    part: int
    rows: slice       # the rectangle of pixels that holds it
    columns: slice
    H_world: Array    # (4, 4): p_j = H p_i


def part_motions(truth_i: FrameTruth, truth_j: FrameTruth) -> list[PartMotion]:
    """The parts seen in frame i that do not stay where they are until frame j."""
    moved = np.any(truth_i.T_world_part != truth_j.T_world_part, axis=(-2, -1))
    windows = ndimage.find_objects(truth_i.part_id + 1, max_label=len(moved))
    motions = []
    for part in np.flatnonzero(moved).tolist():
        if windows[part] is not None:
            rows, columns = windows[part]
            H_world = truth_j.T_world_part[part] @ se3.inverse(truth_i.T_world_part[part])
            motions.append(PartMotion(part, rows, columns, H_world))
    return motions


class Projection:
    """Projects the surface points of frame i, moved to the time of j, in camera j (float64).

    With p = (u, v, 1): z_j (u_j, v_j, 1) = z_i K R K⁻¹ p + K t. The factor K R K⁻¹ p is a sum of
    one row and one column, so that no pixel's ray is ever formed.
    """

    def __init__(self, truth_i: FrameTruth, truth_j: FrameTruth, motions: list[PartMotion],
                 intrinsics: Intrinsics) -> None:
        self._truth = truth_i
        self._motions = motions
        K = intrinsics.matrix
        inverse_K = np.linalg.inv(K)
        T_camera_j_world = se3.inverse(truth_j.T_world_camera)
        H_world = np.stack([np.eye(4), *(each.H_world for each in motions)])
        T_j_i = T_camera_j_world @ H_world @ truth_i.T_world_camera
        self._A, self._b = K @ T_j_i[:, :3, :3] @ inverse_K, T_j_i[:, :3, 3] @ K.T

    def rows(self, rows: slice) -> Array:
        """(3, h, W): u px, v px and z m in camera j of some rows' points.

        Where z is not positive, or nothing is seen, u and v mean nothing.
        """
        part = self._truth.part_id
        out = self._project(0, rows, slice(0, part.shape[1]))
        for number, motion in enumerate(self._motions, start=1):
            common = slice(max(rows.start, motion.rows.start), min(rows.stop, motion.rows.stop))
            if common.start < common.stop:
                moved = self._project(number, common, motion.columns)
                target = out[:, common.start - rows.start:common.stop - rows.start, motion.columns]
                np.copyto(target, moved, where=part[common, motion.columns] == motion.part)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            out[:2] /= out[2]
        return out

    def _project(self, number: int, rows: slice, columns: slice) -> Array:
        A, b = self._A[number], self._b[number]
        v = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None]
        u = np.arange(columns.start, columns.stop, dtype=np.float64)
        depth = self._truth.depth_m[rows, columns].astype(np.float64)
        out = np.empty((3, *depth.shape))
        for axis in range(3):
            np.add(A[axis, 0] * u + A[axis, 2], A[axis, 1] * v, out=out[axis])
            out[axis] *= depth
            out[axis] += b[axis]
        return out


def scene_flow(truth_i: FrameTruth, motions: list[PartMotion], intrinsics: Intrinsics) -> Array:
    """(H, W, 3) float32 motion in the world, in metres, of frame i's surface points."""
    flow = np.zeros((*truth_i.depth_m.shape, 3), np.float32)
    inverse_K = np.linalg.inv(intrinsics.matrix)
    for part, rows, columns, H_world in motions:
        # p_j − p_i = (H − 1) T_world_camera z K⁻¹ (u, v, 1)
        change = (H_world - np.eye(4)) @ truth_i.T_world_camera
        A, b = change[:3, :3] @ inverse_K, change[:3, 3]
        shown = truth_i.part_id[rows, columns] == part
        v, u = np.nonzero(shown)
        moved = (u[:, None] + columns.start) * A[:, 0] + (v[:, None] + rows.start) * A[:, 1]
        moved += A[:, 2]
        moved *= truth_i.depth_m[rows, columns][shown][:, None]
        flow[rows, columns][shown] = moved + b
    return flow
