"""Check a sequence: every hash, and what must hold whatever the scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from simbench import certificate, storage
from simbench.datasets.simbench_folder import SimbenchFolder
from simbench.errors import BadFrame, UserError
from simbench.render import make_renderer
from simbench.sequence import Sequence
from simbench.trajectory_files import read_tum_trajectory
from simbench.types import Trajectories
from slam.geometry.arrays import Array
from slam.types import Frame

_ROTATION_TOLERANCE = 1e-9     # float64 poses
_TEXT_TOLERANCE = 1e-9         # poses read back from text with all their digits


def check_sequence(folder: Path, sequence: Sequence,
                   on_frame: Callable[[], None] = lambda: None) -> list[str]:
    """What is wrong with a sequence, one line for each problem; empty when all is well.

    Of any folder: stamps, poses, and that every frame can be read. Of our own, besides: every
    hash, no file missing or too many, and that masks, depth, parts and text agree with the truth.
    """
    problems = _stamp_problems(sequence)
    ours = sequence if isinstance(sequence, SimbenchFolder) else None
    if ours is not None:
        problems += _hash_problems(folder, ours.made.files)
        problems += [f"{folder / storage.MANIFEST}: {fault}"
                     for fault in certificate.faults(ours.manifest, *ours.truth.poses)]
    try:
        if sequence.truth is not None:
            problems += _pose_problems(sequence.truth.trajectories)
        if ours is not None:
            problems += _text_problems(folder, ours)
    except UserError as error:
        problems.append(str(error))
    for k in range(len(sequence)):
        try:
            frame = sequence.frame(k)
            if ours is not None:
                problems += _frame_problems(ours, frame)
        except BadFrame as error:
            problems.append(str(error))
        on_frame()
    return problems


def drawn_here(sequence: SimbenchFolder) -> list[str]:
    """Why drawing the sequence here could give, or gives, other bytes; empty where it would not.

    The scene is built again and its last frame drawn.

    Raises:
        UserError: the scene cannot be built here.
    """
    truth, world = sequence.truth, sequence.made.make_world()
    found = certificate.differences(sequence.manifest, world)
    last = len(sequence) - 1
    world.restore(truth.states()[last])
    renderer = make_renderer("mujoco", world)
    depth_m, part_id = renderer.depth_and_parts(world)
    renderer.close()
    stored = truth.frame(last)
    if not (np.array_equal(depth_m, stored.depth_m) and np.array_equal(part_id, stored.part_id)):
        found.append(f"frame {last} drawn here has other bytes")
    return found


def _stamp_problems(sequence: Sequence) -> list[str]:
    late = np.flatnonzero(np.diff(sequence.stamps_s) <= 0)
    return [f"frame {int(k) + 1}: its stamp is not later than the one before" for k in late]


def _hash_problems(folder: Path, wanted: Mapping[str, str]) -> list[str]:
    problems = []
    found = storage.file_hashes(folder)
    for name in sorted(wanted.keys() | found.keys()):
        if name not in found:
            problems.append(f"{folder / name}: missing")
        elif name not in wanted:
            problems.append(f"{folder / name}: not in {storage.MANIFEST}")
        elif found[name] != wanted[name]:
            problems.append(f"{folder / name}: its SHA-256 is not the one in {storage.MANIFEST}")
    return problems


def _pose_problems(truth: Trajectories) -> list[str]:
    poses = {"camera": (truth.T_world_camera, truth.camera_valid)}
    poses |= {f"object {i}": (o.T_world_object, o.valid) for i, o in truth.objects.items()}
    problems = []
    for name, (T, valid) in poses.items():
        for k in np.flatnonzero(valid & (_off_rotation(T) > _ROTATION_TOLERANCE)):
            problems.append(f"frame {int(k)}: the rotation of {name} is not orthonormal")
    return problems


def _off_rotation(T: Array) -> Array:
    """(K,) how far the rotations of (K, 4, 4) are from SO(3); inf for NaN and reflections."""
    R = T[:, :3, :3]
    gap = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    good = np.isfinite(T).all(axis=(1, 2)) & (np.linalg.det(R) > 0)
    return np.where(good, gap, np.inf)


def _text_problems(folder: Path, sequence: SimbenchFolder) -> list[str]:
    stamps_s, T = read_tum_trajectory(folder / "groundtruth.txt")
    truth = sequence.truth.trajectories.T_world_camera
    if len(stamps_s) != len(truth) or np.abs(T - truth).max() > _TEXT_TOLERANCE:
        return [f"{folder / 'groundtruth.txt'}: not the camera poses of {storage.TRUTH}"]
    return []


def _frame_problems(sequence: SimbenchFolder, frame: Frame) -> list[str]:
    """Masks, parts and depth of one frame of ours against each other."""
    k, truth, layout = frame.index, sequence.truth.frame(frame.index), sequence.truth.layout
    objects = np.array([0, *(o.instance_id for o in layout.objects)])
    parts = len(layout.instance_of_part)
    checks = {
        "its masks are not those of its parts": np.all(frame.instance_id == truth.instance_id),
        "it shows an object that is not listed": np.isin(truth.instance_id, objects).all(),
        "it shows a part that does not exist": ((truth.part_id >= -1)
                                                & (truth.part_id < parts)).all(),
        "depth without a part, or a part without depth": np.array_equal(truth.part_id >= 0,
                                                                        truth.depth_m > 0),
        "its true depth is not finite": np.isfinite(truth.depth_m).all(),
    }
    if sequence.made.sensor == "ideal":
        scale = sequence.calibration.depth_scale
        wanted = storage.encode_depth(truth.depth_m, scale).astype(np.float32) / np.float32(scale)
        checks["its depth image is not its true depth"] = np.array_equal(frame.depth_m, wanted)
    return [f"frame {k}: {what}" for what, holds in checks.items() if not holds]
