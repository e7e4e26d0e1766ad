"""Where every pixel's surface point goes: with its part, into another camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from simbench.types import FrameTruth
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics


class Carried(NamedTuple):
    """Projection of frame i's surface points in camera j; of no meaning where there is no surface."""

    u_px: Array      # (H, W) float64
    v_px: Array      # (H, W) float64
    depth_m: Array   # (H, W) float64 z-depth in camera j; not positive behind it


def moved_parts(truth_i: FrameTruth, truth_j: FrameTruth) -> Array:
    """(P,) bool: parts whose poses differ between the two frames."""
    return np.any(truth_i.T_world_part != truth_j.T_world_part, axis=(-2, -1))


def part_windows(truth: FrameTruth, parts: Array) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """Those of the parts (P,) bool that are seen in a frame, each with its rectangle of pixels."""
    windows = ndimage.find_objects(truth.part_id + 1, max_label=len(parts))
    return ((part, windows[part]) for part in np.flatnonzero(parts) if windows[part] is not None)


def carry(truth_i: FrameTruth, truth_j: FrameTruth, intrinsics: Intrinsics) -> Carried:
    """Project the surface points of frame i, moved to the time of j, in camera j (float64)."""
    T_camera_j_world = se3.inverse(truth_j.T_world_camera)
    depth = truth_i.depth_m.astype(np.float64)
    height, width = depth.shape
    out = np.empty((3, height, width))
    whole = (slice(0, height), slice(0, width))
    _project(depth, whole, T_camera_j_world @ truth_i.T_world_camera, intrinsics, out)
    for part, window in part_windows(truth_i, moved_parts(truth_i, truth_j)):
        motion = truth_j.T_world_part[part] @ se3.inverse(truth_i.T_world_part[part])
        T_j_i = T_camera_j_world @ motion @ truth_i.T_world_camera
        rows, columns = window
        local = np.empty((3, rows.stop - rows.start, columns.stop - columns.start))
        _project(depth[window], window, T_j_i, intrinsics, local)
        np.copyto(out[:, rows, columns], local, where=truth_i.part_id[window] == part)
    return Carried(*out)


def _project(depth: Array, window: tuple[slice, slice], T_j_i: Array, intrinsics: Intrinsics,
             out: Array) -> None:
    """(u, v, z) of a rectangle of pixels after a rigid motion, into out (3, h, w).

    With p = (u, v, 1): z_j (u_j, v_j, 1) = z_i K R K⁻¹ p + K t. The factor K R K⁻¹ p is a sum of
    one row and one column, so that no pixel's ray is ever formed.
    """
    K = intrinsics.matrix
    A, b = K @ T_j_i[:3, :3] @ np.linalg.inv(K), K @ T_j_i[:3, 3]
    rows, columns = window
    v = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None]
    u = np.arange(columns.start, columns.stop, dtype=np.float64)
    for axis in range(3):
        np.add(A[axis, 0] * u + A[axis, 2], A[axis, 1] * v, out=out[axis])
        out[axis] *= depth
        out[axis] += b[axis]
    with np.errstate(divide="ignore", invalid="ignore"):
        out[:2] /= out[2]


def scene_flow(truth_i: FrameTruth, truth_j: FrameTruth, intrinsics: Intrinsics) -> Array:
    """(H, W, 3) float32 motion in the world, in metres, of frame i's surface points."""
    flow = np.zeros((*truth_i.depth_m.shape, 3), np.float32)
    inverse_K = np.linalg.inv(intrinsics.matrix)
    for part, window in part_windows(truth_i, moved_parts(truth_i, truth_j)):
        motion = truth_j.T_world_part[part] @ se3.inverse(truth_i.T_world_part[part])
        # p_j − p_i = (motion − 1) T_world_camera z K⁻¹ (u, v, 1)
        change = (motion - np.eye(4)) @ truth_i.T_world_camera
        A, b = change[:3, :3] @ inverse_K, change[:3, 3]
        rows, columns = window
        v = np.arange(rows.start, rows.stop, dtype=np.float64)[:, None, None]
        u = np.arange(columns.start, columns.stop, dtype=np.float64)[:, None]
        moved = truth_i.depth_m[window][..., None] * (A[:, 0] * u + A[:, 2] + A[:, 1] * v) + b
        np.copyto(flow[window], moved, where=(truth_i.part_id[window] == part)[..., None],
                  casting="same_kind")
    return flow
