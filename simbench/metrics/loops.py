"""Places that a system says to have seen before: how many, where, and whether that is so."""

from __future__ import annotations

from typing import Any

import numpy as np

from simbench.metrics.estimates import frames_of_stamps
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import SlamResult

FALSE_M, FALSE_DEG = 0.5, 5.0    # a loop that claims a pose so far off is of another place


def loop_metrics(result: SlamResult, stamps_s: Array, truth: Trajectories | None
                 ) -> dict[str, Any]:
    """`closed`, `false` and each loop under `at`; empty for a system that looks for none.

    Args:
        stamps_s: (K,) of the frames of the sequence.
    """
    loops = result.loops
    if loops is None:
        return {}
    frame = frames_of_stamps(stamps_s, result.stamps_s, 1e-4)
    now, before = frame[loops.row], frame[loops.seen_before]
    at = [{"frame": int(a), "seen_before": int(b), "position_m": place.tolist()}
          for a, b, place in zip(now, before, result.T_world_camera[loops.row, :3, 3],
                                 strict=True)]
    out: dict[str, Any] = {"closed": len(loops), "at": at}
    if truth is None:
        return out
    error_m, error_deg = loop_errors(loops.T_before_now, truth.T_world_camera[before],
                                     truth.T_world_camera[now])
    known = truth.camera_valid[before] & truth.camera_valid[now]
    for each, m, deg, is_known in zip(at, error_m, error_deg, known, strict=True):
        if is_known:
            each |= {"error_m": float(m), "error_deg": float(deg)}
    out["false"] = int(np.count_nonzero(known & is_false(error_m, error_deg)))
    return out


def loop_errors(T_before_now: Array, T_world_before: Array, T_world_now: Array
                ) -> tuple[Array, Array]:
    """Metres and degrees (N,) by which claimed relative poses (N, 4, 4) are off."""
    error = se3.inverse(T_before_now) @ se3.inverse(T_world_before) @ T_world_now
    return (np.linalg.norm(error[:, :3, 3], axis=1),
            np.degrees(se3.rotation_angle(error[:, :3, :3])))


def is_false(error_m: Array, error_deg: Array) -> Array:
    """(N,) bool: which loops are of another place."""
    return np.asarray((error_m > FALSE_M) | (error_deg > FALSE_DEG))
