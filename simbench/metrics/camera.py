"""The `camera` block of metrics.json, and the errors of each frame behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simbench.metrics.estimates import CameraEstimates
from simbench.metrics.motion import motion_errors
from simbench.metrics.moving import step_valid, truth_smoothness_floor
from simbench.metrics.trajectory import (
    ate_errors,
    frame_pairs,
    rpe_errors,
    statistics,
    time_pairs,
)
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array

_FEWEST_TO_ALIGN = 3        # fewer positions align onto any others, or but for a distance


@dataclass(frozen=True, slots=True)
class MotionErrors:
    """Errors of the frames that have an estimate and a truth."""

    frame: Array      # (N,) int: the frame the motion ends in
    t_m: Array        # (N,)
    r_deg: Array      # (N,)


def gauge(camera: CameraEstimates, truth: Trajectories) -> Array | None:
    """S = X X̂⁻¹ (4, 4) of the first frame with both: from the estimate's world to the true one."""
    both = np.flatnonzero(camera.pose_known & truth.camera_valid)
    if not len(both):
        return None
    k = both[0]
    return np.asarray(truth.T_world_camera[k] @ se3.inverse(camera.T_world_camera[k]))


def camera_step_errors(camera: CameraEstimates, truth: Trajectories) -> MotionErrors:
    """E of the motion that ended in each frame, where it was estimated and the truth is known."""
    frame = np.flatnonzero(camera.step_known & step_valid(truth.camera_valid))
    true_steps = se3.inverse(truth.T_world_camera[frame - 1]) @ truth.T_world_camera[frame]
    return MotionErrors(frame, *motion_errors(camera.T_previous_camera[frame], true_steps))


def camera_metrics(camera: CameraEstimates, truth: Trajectories, exact: bool) -> dict[str, Any]:
    """E_t, E_R (means over frames), coverage, ATE and RPE; empty where no truth is known.

    Args:
        exact: the truth is a simulator's. Else `truth_smoothness_floor` stands beside the errors.
    """
    steps = step_valid(truth.camera_valid)
    out: dict[str, Any] = {}
    errors = camera_step_errors(camera, truth)
    if len(errors.frame):
        out |= {"E_t": float(errors.t_m.mean()), "E_R": float(errors.r_deg.mean())}
    if np.any(steps):
        out["coverage"] = len(errors.frame) / int(np.count_nonzero(steps))
    both = camera.pose_known & truth.camera_valid
    if np.count_nonzero(both) >= _FEWEST_TO_ALIGN:
        out["ate"] = statistics(ate_errors(camera.T_world_camera[both],
                                           truth.T_world_camera[both])) \
            | {"coverage": int(both.sum()) / int(truth.camera_valid.sum())}
    rpe = {"1f": _rpe(errors.t_m, errors.r_deg, int(np.count_nonzero(steps)))} \
        | {key: _rpe_over(camera, truth, pairs) for key, pairs in _pairs(truth.stamps_s).items()}
    rpe = {key: block for key, block in rpe.items() if block}
    if rpe:
        out["rpe"] = rpe
    floor = None if exact else truth_smoothness_floor(truth.stamps_s, truth.T_world_camera, steps)
    if floor:
        out["truth_smoothness_floor"] = floor
    return out


def _pairs(stamps_s: Array) -> dict[str, Array]:
    """Over a second the motion is measured backward, as the TUM benchmark's script does it."""
    return {"10f": frame_pairs(len(stamps_s), 10), "1s": time_pairs(stamps_s, 1.0)[:, ::-1]}


def _rpe_over(camera: CameraEstimates, truth: Trajectories, pairs: Array) -> dict[str, float]:
    pairs = pairs[truth.camera_valid[pairs].all(axis=1)]
    known = pairs[camera.pose_known[pairs].all(axis=1)]
    return _rpe(*rpe_errors(camera.T_world_camera, truth.T_world_camera, known), len(pairs))


def _rpe(t_m: Array, r_deg: Array, of: int) -> dict[str, float]:
    if not len(t_m):
        return {}
    t, r = statistics(t_m), statistics(r_deg)
    return {"t_rmse": t["rmse"], "t_mean": t["mean"], "t_std": t["std"],
            "r_rmse_deg": r["rmse"], "r_mean_deg": r["mean"], "r_std_deg": r["std"],
            "r_rmse_rad": float(np.radians(r["rmse"])), "coverage": len(t_m) / of}


