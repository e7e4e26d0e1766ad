"""Which true objects move in which frames, and how smooth a recording's truth is."""

from __future__ import annotations

import numpy as np

from simbench.metrics.motion import increments, motion_errors
from simbench.types import ObjectPoses
from slam.geometry import se3
from slam.geometry.arrays import Array

# Exact truth: less than this between two frames is rest (a pendulum at its turning point).
MOVING_M = 1e-3
MOVING_DEG = 0.05
# A recording's truth jitters from frame to frame (a parked KITTI car by 0.06 m), so there an
# object moves if it does so over a second: parked cars of KITTI tracking 0003 stand at 0.4 m/s
# and 0.7 deg/s at most, its driving ones at 14 m/s.
RECORDED_MOVING_M_S = 0.5
RECORDED_MOVING_DEG_S = 10.0
RECORDED_WINDOW_S = 1.0


def step_valid(valid: Array) -> Array:
    """(K,) bool: a true pose is known here and in the frame before. Frame 0 has none before."""
    out = np.zeros(len(valid), dtype=bool)
    out[1:] = valid[1:] & valid[:-1]
    return out


def moving_frames(poses: ObjectPoses, stamps_s: Array, exact: bool) -> Array:
    """(K,) bool: the object's true motion from the frame before is known and is a motion.

    Args:
        exact: the truth is a simulator's: judged frame by frame, above 1 mm or 0.05°. Else one
            judgement for the whole recording: mean displacement over windows of a second above
            0.5 m/s, or turn above 10°/s.
    """
    known = step_valid(poses.valid)
    if not exact:
        return known & _moves_over_a_second(poses, stamps_s)
    moved = np.zeros(len(known), dtype=bool)
    T = increments(poses.T_world_object)
    moved[1:] = (np.linalg.norm(T[:, :3, 3], axis=-1) > MOVING_M) \
        | (np.degrees(se3.rotation_angle(T[:, :3, :3])) > MOVING_DEG)
    return known & moved


def _moves_over_a_second(poses: ObjectPoses, stamps_s: Array) -> bool:
    seen = np.flatnonzero(poses.valid)
    if len(seen) < 2:
        return False
    t, L = np.asarray(stamps_s)[seen], poses.T_world_object[seen]
    end = np.minimum(np.searchsorted(t, t + RECORDED_WINDOW_S - 1e-9), len(t) - 1)
    start = np.flatnonzero(end > np.arange(len(t)))
    # Where the object is seen for a second at all, windows cut short by its end are left out.
    whole = t[end[start]] - t[start] >= RECORDED_WINDOW_S - 1e-9
    start = start[whole] if np.any(whole) else start[:1]
    T = se3.inverse(L[start]) @ L[end[start]]
    lasted = t[end[start]] - t[start]
    speed = np.linalg.norm(T[:, :3, 3], axis=-1) / lasted
    turn = np.degrees(se3.rotation_angle(T[:, :3, :3])) / lasted
    return bool(speed.mean() > RECORDED_MOVING_M_S or turn.mean() > RECORDED_MOVING_DEG_S)


def truth_smoothness_floor(stamps_s: Array, T_world_body: Array, used: Array
                           ) -> dict[str, float] | None:
    """E_t and E_R that a straight line through the true increments scores, without any vision.

    Where truth is GPS/INS its increments jump from frame to frame, and no estimate that is right
    can score less than about this; a smoothed one can. The six numbers of each increment's
    logarithm are fitted linearly in time over the frames `used` (K,) bool; None below 4 of them.
    """
    frames = np.flatnonzero(used)
    if len(frames) < 4:
        return None
    T = se3.inverse(T_world_body[frames - 1]) @ T_world_body[frames]
    t = np.asarray(stamps_s)[frames]
    basis = np.stack([np.ones(len(t)), t - t.mean()], axis=-1)
    line = basis @ np.linalg.lstsq(basis, se3.log(T), rcond=None)[0]
    t_m, r_deg = motion_errors(se3.exp(line), T)
    return {"E_t": float(t_m.mean()), "E_R": float(r_deg.mean())}
