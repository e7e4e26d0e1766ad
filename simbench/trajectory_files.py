"""Trajectories as text: TUM (`t tx ty tz qx qy qz qw`) and KITTI (12 numbers of a 3×4 pose)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.datasets.rows import read_numbers
from simbench.errors import BadFile
from slam.geometry import se3
from slam.geometry.arrays import Array

_TUM = "t tx ty tz qx qy qz qw"


def read_tum_trajectory(path: str | Path) -> tuple[Array, Array]:
    """Stamps (K,) in seconds and poses (K, 4, 4), sorted by stamp.

    Raises:
        BadFile: a row is broken or its quaternion is zero (the line is named), or two rows
            bear the same stamp.
    """
    path = Path(path)
    rows = read_numbers(path, 8, _TUM)
    length = np.linalg.norm(rows[:, 4:8], axis=1)
    if np.any(length < 1e-6):
        row = int(np.argmin(length)) + 1
        raise BadFile(f"{path}: the quaternion of pose {row} is zero ({_TUM}); "
                      "mend or remove this row")
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    twice = np.flatnonzero(np.diff(rows[:, 0]) == 0)
    if len(twice):
        raise BadFile(f"{path}: stamp {rows[twice[0], 0]:.6f} stands twice; remove one of the rows")
    R = se3.rotation_from_quaternion(rows[:, 4:8]) if len(rows) else np.zeros((0, 3, 3))
    return rows[:, 0], se3.from_rotation_translation(R, rows[:, 1:4])


def tum_lines(stamps_s: Array, T: Array) -> str:
    """TUM rows of poses (K, 4, 4): stamps to 1 µs, the rest to all of their digits."""
    quaternion = se3.quaternion_from_rotation(T[:, :3, :3])
    rows = np.concatenate([T[:, :3, 3], quaternion], axis=1)
    return "".join(f"{stamp:.6f} " + " ".join(f"{x:.17g}" for x in row) + "\n"
                   for stamp, row in zip(stamps_s, rows, strict=True))


def write_tum_trajectory(path: str | Path, stamps_s: Array, T_world_camera: Array) -> None:
    """Write poses (K, 4, 4) as TUM rows."""
    Path(path).write_text(tum_lines(stamps_s, T_world_camera), encoding="utf-8")


def read_kitti_poses(path: str | Path) -> Array:
    """Poses (K, 4, 4) from rows of 12 numbers (3×4, row-major).

    Raises:
        BadFile: a row is broken (the line is named) or its rotation is none.
    """
    path = Path(path)
    rows = read_numbers(path, 12, "the 12 numbers of a 3×4 pose")
    T = np.zeros((len(rows), 4, 4))
    T[:, :3] = rows.reshape(-1, 3, 4)
    T[:, 3, 3] = 1.0
    return checked_poses(path, T)


def kitti_lines(T: Array) -> str:
    """KITTI rows of poses (K, 4, 4): the 12 numbers of each 3×4 matrix."""
    return "".join(" ".join(f"{x:.17g}" for x in row) + "\n" for row in T[:, :3].reshape(-1, 12))


def write_kitti_poses(path: str | Path, T_world_camera: Array) -> None:
    """Write poses (K, 4, 4) as rows of 12 numbers."""
    Path(path).write_text(kitti_lines(T_world_camera), encoding="utf-8")


def checked_poses(path: Path, T: Array) -> Array:
    """Poses (K, 4, 4) read from text, their rotations rounded back onto SO(3).

    Raises:
        BadFile: a rotation is off by more than the rounding of a text file could make it.
    """
    R = T[:, :3, :3]
    gap = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = (gap > 1e-2) | (np.linalg.det(R) < 0)
    if np.any(bad):
        raise BadFile(f"{path}: the rotation of pose {int(np.argmax(bad)) + 1} is not a rotation; "
                      "mend or remove this row")
    return se3.orthonormalised(T) if len(T) else T
