"""Truth of the VDO layout: pose_gt.txt, and object_pose.txt of either kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from simbench.datasets.rows import read_numbers, whole_numbers
from simbench.errors import BadFile, BadFrame
from simbench.trajectory_files import checked_poses
from simbench.types import ObjectPoses, Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array

_MOST_POSES = 10_000_000


def read_trajectories(folder: Path, stamps_s: Array, object_rows_in_camera: bool,
                      instances: Callable[[int], Array | None]) -> Trajectories:
    """True poses of camera and objects.

    An object is valid in a frame where a row gives its pose and, where there are masks, a mask
    shows it. Poses that no row gives are the identity and not valid.

    Args:
        object_rows_in_camera: KITTI rows (`k id x1 y1 x2 y2 tx ty tz ry` in the camera's frame),
            else metric ones (`k id tx ty tz rx ry rz` in the world).
        instances: reads the mask of a frame; None where there are no masks.
    Raises:
        BadFile: a row is broken or speaks of a frame that is not there.
    """
    count = len(stamps_s)
    T_world_camera, camera_valid = _camera_poses(folder / "pose_gt.txt", count)
    path = folder / "object_pose.txt"
    if not path.exists():
        return Trajectories(stamps_s, T_world_camera, camera_valid, {})
    if object_rows_in_camera:
        frame, label, T = _kitti_rows(path)
    else:
        frame, label, T = _metric_rows(path)
    _check_frames(path, frame, count)
    if object_rows_in_camera:
        T = T_world_camera[frame] @ T
    seen = _labels_seen(instances, count) if len(frame) else []
    objects = {}
    numbers = np.unique(label)
    if len(numbers) * count > _MOST_POSES:
        raise BadFile(f"{path}: {len(numbers)} objects in {count} frames; at most {_MOST_POSES} "
                      "poses fit in memory")
    for number in numbers:
        poses, valid = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, dtype=bool)
        rows = label == number
        poses[frame[rows]] = T[rows]
        valid[frame[rows]] = camera_valid[frame[rows]] if object_rows_in_camera else True
        valid &= [labels is None or int(number) in labels for labels in seen]
        objects[int(number)] = ObjectPoses(poses, valid)
    return Trajectories(stamps_s, T_world_camera, camera_valid, objects)


def _camera_poses(path: Path, count: int) -> tuple[Array, Array]:
    rows = read_numbers(path, 17, "k and the 16 numbers of T_world_camera")
    frame = whole_numbers(path, rows[:, 0], "k")
    _check_frames(path, frame, count)
    T, valid = np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, dtype=bool)
    T[frame] = checked_poses(path, rows[:, 1:].reshape(-1, 4, 4))
    valid[frame] = True
    return T, valid


def _kitti_rows(path: Path) -> tuple[Array, Array, Array]:
    """Frames, labels and T_camera_object; R = R_y(ry + π/2)."""
    rows = read_numbers(path, 10, "k id x1 y1 x2 y2 tx ty tz ry")
    turn = np.zeros((len(rows), 3))
    turn[:, 1] = rows[:, 9] + np.pi / 2
    T = se3.from_rotation_translation(se3.exp_so3(turn), rows[:, 6:9])
    return whole_numbers(path, rows[:, 0], "k"), whole_numbers(path, rows[:, 1], "id"), T


def _metric_rows(path: Path) -> tuple[Array, Array, Array]:
    """Frames, labels and T_world_object, its rotation as a rotation vector."""
    rows = read_numbers(path, 8, "k id tx ty tz rx ry rz")
    T = se3.from_rotation_translation(se3.exp_so3(rows[:, 5:8]), rows[:, 2:5])
    return whole_numbers(path, rows[:, 0], "k"), whole_numbers(path, rows[:, 1], "id"), T


def _check_frames(path: Path, frame: Array, count: int) -> None:
    outside = (frame < 0) | (frame >= count)
    if np.any(outside):
        raise BadFile(f"{path}: a row is of frame {frame[np.argmax(outside)]}, but times.txt has "
                      f"{count} frames (counted from 0); mend or remove this row")


def _labels_seen(instances: Callable[[int], Array | None], count: int) -> list[set[int] | None]:
    """Per frame, the labels in its mask; None without masks, none seen where it is unreadable."""
    seen: list[set[int] | None] = []
    for k in range(count):
        try:
            mask = instances(k)
        except BadFrame:
            seen.append(set())   # the frame itself is lost with the same error when it is read
            continue
        seen.append(None if mask is None else set(np.unique(mask).tolist()))
    return seen
