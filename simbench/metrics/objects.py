"""The `objects` block of metrics.json, and the errors of each frame behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simbench.metrics.association import identity_switches, scored_rows
from simbench.metrics.camera import gauge
from simbench.metrics.estimates import NO_OBJECT, CameraEstimates, ObjectMotions
from simbench.metrics.motion import body_motion, motion_errors, moved_to_world
from simbench.metrics.moving import moving_frames, truth_smoothness_floor
from simbench.types import ObjectPoses, Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class ObjectErrors:
    """The scored motions of one true object."""

    name: str
    rigid: bool
    frame: Array            # (N,) int: the frame each scored motion ends in
    row: Array              # (N,) int: its row in the ObjectMotions
    t_m: Array              # (N,) in the true world, camera drift included
    r_deg: Array
    local_t_m: Array        # (N,) seen from the camera: free of drift
    local_r_deg: Array
    moving: Array           # (K,) bool: frames in which the object truly moves
    false_motions: int      # frames in which it is seen, stands still, and has an estimate


def object_errors(motions: ObjectMotions, owner: Mapping[int, int], camera: CameraEstimates,
                  truth: Trajectories, exact: bool) -> dict[int, ObjectErrors]:
    """Every true object with the errors of its scored motions.

    A motion is scored in the frames in which the object truly moves (`moving_frames`) and is
    known before and after. Its error is in the body frame of the true pose before (EQUATIONS 7).

    Args:
        owner: track -> true object (NO_OBJECT for none).
        exact: the truth is a simulator's.
    """
    S = gauge(camera, truth)
    return {true_id: _errors_of(true_id, poses, motions, dict(owner), S, truth, exact)
            for true_id, poses in sorted(truth.objects.items())}


def _errors_of(true_id: int, poses: ObjectPoses, motions: ObjectMotions, owner: dict[int, int],
               S: Array | None, truth: Trajectories, exact: bool) -> ObjectErrors:
    moving = moving_frames(poses, truth.stamps_s, exact)
    rows = scored_rows(motions, owner, true_id)
    frames = motions.frame[rows]
    seen = poses.valid[frames] & poses.valid[frames - 1]
    false_motions = int(np.count_nonzero(seen & ~moving[frames]))
    rows = rows[moving[frames]] if S is not None else rows[:0]
    frames = motions.frame[rows]
    L, T_true = poses.T_world_object[frames - 1], poses.T_world_object[frames]
    T_true = se3.inverse(L) @ T_true
    H = motions.H_world[rows]
    in_world = moved_to_world(np.eye(4) if S is None else S, H)
    t_m, r_deg = motion_errors(body_motion(L, in_world), T_true)
    at_camera = truth.T_world_camera[frames - 1] @ se3.inverse(motions.T_world_camera[rows])
    local_t_m, local_r_deg = motion_errors(body_motion(L, moved_to_world(at_camera, H)), T_true)
    known = truth.camera_valid[frames - 1]
    return ObjectErrors(poses.name, poses.rigid, frames, rows, t_m, r_deg,
                        np.where(known, local_t_m, np.nan), np.where(known, local_r_deg, np.nan),
                        moving, false_motions)


def object_metrics(errors: Mapping[int, ObjectErrors], motions: ObjectMotions,
                   owner: Mapping[int, int], truth: Trajectories, exact: bool
                   ) -> dict[str, Any]:
    """The block: each true object by its number, and `mean`.

    An object that never moves has no errors and no coverage; `mean` pools the frames of the
    rigid objects that move.
    """
    out: dict[str, Any] = {str(i): _one(e, truth.objects[i], truth.stamps_s, exact)
                           for i, e in errors.items()}
    pooled = [e for e in errors.values() if e.rigid and np.any(e.moving)]
    mean: dict[str, Any] = {}
    if pooled:
        mean = _means([e for e in pooled if len(e.frame)])
        frames = sum(len(e.frame) for e in pooled)
        mean |= {"frames": frames,
                 "coverage": frames / sum(int(e.moving.sum()) for e in pooled)}
    mean["id_switches"] = sum(identity_switches(motions, i) for i in errors)
    mean["false_motions"] = sum(e.false_motions for e in errors.values())
    mean["tracks_without_object"] = sum(1 for true_id in owner.values() if true_id == NO_OBJECT)
    return out | {"mean": mean}


def _one(errors: ObjectErrors, poses: ObjectPoses, stamps_s: Array, exact: bool
         ) -> dict[str, Any]:
    moving = int(errors.moving.sum())
    out: dict[str, Any] = {"rigid": errors.rigid, "moving_frames": moving,
                           "frames": len(errors.frame), "false_motions": errors.false_motions}
    if poses.name:
        out["name"] = poses.name
    if not moving:
        return out
    out |= _means([errors] if len(errors.frame) else [])
    out["coverage"] = len(errors.frame) / moving
    floor = None if exact else truth_smoothness_floor(stamps_s, poses.T_world_object,
                                                      errors.moving)
    if floor:
        out["truth_smoothness_floor"] = floor
    return out


def _means(errors: list[ObjectErrors]) -> dict[str, float]:
    """Means over all frames of some objects; what no frame has is absent."""
    columns = {"E_t": [e.t_m for e in errors], "E_R": [e.r_deg for e in errors],
               "E_t_local": [e.local_t_m for e in errors],
               "E_R_local": [e.local_r_deg for e in errors]}
    pooled = {key: np.concatenate([np.zeros(0), *values]) for key, values in columns.items()}
    return {key: float(values[np.isfinite(values)].mean())
            for key, values in pooled.items() if np.any(np.isfinite(values))}
