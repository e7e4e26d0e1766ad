"""Trajectories and object motions that another program estimated, read from text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.datasets.rows import numbers_of, read_rows
from simbench.errors import BadFile
from simbench.metrics.estimates import (
    CameraEstimates,
    ObjectMotions,
    camera_from_poses,
    frames_of_stamps,
    motions_of_rows,
)
from simbench.trajectory_files import read_tum_trajectory
from slam.geometry import se3
from slam.geometry.arrays import Array

TOLERANCE_S = 0.02   # as the TUM benchmark's scripts associate stamps
_MOTION_ROW = "stamp_previous stamp track cx cy cz and the 16 numbers of H"
_POSE_ROW = "stamp track tx ty tz qx qy qz qw"
_MOTION_COLUMNS, _POSE_COLUMNS = 22, 9


def tolerance(stamps_s: Array) -> float:
    """Within what time a stamp belongs to a frame: 0.02 s, or half a frame where that is less."""
    period = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else np.inf
    return min(TOLERANCE_S, 0.5 * period)


def read_camera(path: Path, stamps_s: Array) -> tuple[CameraEstimates, list[str]]:
    """A TUM trajectory at the frames with stamps (K,), and what of it was left out.

    Raises:
        BadFile: a broken row (the line is named), or no pose at any frame.
    """
    stamps, poses = read_tum_trajectory(path)
    if len(stamps) == 0:
        raise BadFile(f"{path}: has no rows; it must hold TUM rows, t tx ty tz qx qy qz qw")
    limit = tolerance(stamps_s)
    frame = frames_of_stamps(stamps_s, stamps, limit)
    if not np.any(frame >= 0):
        raise BadFile(f"{path}: none of its {len(stamps)} poses lies within {limit:.3f} s of a "
                      f"frame ({stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s); check the stamps")
    # Of several poses at one frame the nearest in time is taken.
    gap = np.abs(stamps - stamps_s[frame])
    order = np.lexsort((gap, frame))
    chosen = order[np.r_[True, np.diff(frame[order]) > 0] & (frame[order] >= 0)]
    T = np.broadcast_to(np.eye(4), (len(stamps_s), 4, 4)).copy()
    known = np.zeros(len(stamps_s), dtype=bool)
    T[frame[chosen]] = poses[chosen]
    known[frame[chosen]] = True
    left_out = len(stamps) - len(chosen)
    notes = [f"{path}: {left_out} poses belong to no frame of their own; left out"] \
        if left_out else []
    return camera_from_poses(T, known), notes


def read_motions(path: Path, stamps_s: Array, camera: CameraEstimates
                 ) -> tuple[ObjectMotions, list[str]]:
    """Object motions of either kind of file, told by its columns, and what was left out.

    `object_motions.txt` has rows `stamp_previous stamp track cx cy cz` + 16 numbers of H,
    `objects.txt` rows `stamp track tx ty tz qx qy qz qw`, whose motions are those between a
    track's poses in neighbouring frames.

    Raises:
        BadFile: a broken row (the line is named).
    """
    rows = read_rows(path)
    motions = not rows or len(rows[0][1]) >= _MOTION_COLUMNS
    columns, meaning = (_MOTION_COLUMNS, _MOTION_ROW) if motions else (_POSE_COLUMNS, _POSE_ROW)
    table = np.array([numbers_of(path, line, words, columns, meaning) for line, words in rows])
    table = table.reshape(-1, columns)
    lines = np.array([line for line, _ in rows], dtype=np.int64)
    parse = _motions_of_motion_rows if motions else _motions_of_pose_rows
    before, frame, track, centroid, H = parse(path, table, lines, stamps_s)
    keep = (before >= 0) & (frame == before + 1)
    found = motions_of_rows(frame[keep], track[keep], H[keep], centroid[keep], camera)
    left_out = len(frame) - len(found)
    notes = [f"{path}: {left_out} motions are not from one frame to the next with a camera pose; "
             "left out"] if left_out else []
    return found, notes


_Parsed = tuple[Array, Array, Array, Array, Array]


def _motions_of_motion_rows(path: Path, table: Array, lines: Array, stamps_s: Array) -> _Parsed:
    H = table[:, 6:22].reshape(-1, 4, 4)
    R = H[:, :3, :3]
    gap = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
    last = np.abs(H[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
    _refuse(path, lines, (gap > 1e-2) | (last > 1e-6) | (np.linalg.det(R) < 0),
            "H is not a rigid motion")
    limit = tolerance(stamps_s)
    return (frames_of_stamps(stamps_s, table[:, 0], limit),
            frames_of_stamps(stamps_s, table[:, 1], limit),
            _tracks(path, table[:, 2], lines), table[:, 3:6],
            se3.orthonormalised(H) if len(H) else H)


def _motions_of_pose_rows(path: Path, table: Array, lines: Array, stamps_s: Array) -> _Parsed:
    quaternion = table[:, 5:9]
    _refuse(path, lines, np.linalg.norm(quaternion, axis=1) < 1e-6, "the quaternion is zero")
    T = se3.from_rotation_translation(se3.rotation_from_quaternion(quaternion), table[:, 2:5])
    track = _tracks(path, table[:, 1], lines)
    frame = frames_of_stamps(stamps_s, table[:, 0], tolerance(stamps_s))
    order = np.lexsort((table[:, 0], track))
    first, second = order[:-1], order[1:]
    same = track[first] == track[second]
    first, second = first[same], second[same]
    return (frame[first], frame[second], track[second], T[first, :3, 3],
            T[second] @ se3.inverse(T[first]))


def _tracks(path: Path, numbers: Array, lines: Array) -> Array:
    _refuse(path, lines, (numbers != np.round(numbers)) | (np.abs(numbers) > 2**31),
            "the track is not a whole number")
    return np.asarray(numbers.astype(np.int64))


def _refuse(path: Path, lines: Array, bad: Array, fault: str) -> None:
    if np.any(bad):
        raise BadFile(f"{path}:{lines[np.argmax(bad)]}: {fault}; mend or remove this row")
