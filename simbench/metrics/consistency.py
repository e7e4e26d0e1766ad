"""Do the covariances that a system states match its errors, and how far are these from the bound?

NEES is εᵀ P⁻¹ ε of a motion's error ε and its stated covariance P: χ² with six degrees of freedom
where P is right. Efficiency is the Cramér–Rao bound over the mean squared error.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import chi2

from simbench.metrics.camera import MotionErrors
from simbench.metrics.efficiency import Bounds
from simbench.metrics.estimates import CameraEstimates, ObjectMotions
from simbench.metrics.objects import ObjectErrors
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array

FREEDOM = 6
CONFIDENCE = 0.95


def nees(T_estimated: Array, T_true: Array, covariance: Array) -> Array:
    """(N,) εᵀ P⁻¹ ε with ε = Log(T̂⁻¹ T); 6 on average where the covariances are right.

    Args:
        T_estimated, T_true: (N, 4, 4); covariance: (N, 6, 6) of T̂ Exp(ξ), ξ = [ω, v].
    """
    epsilon = se3.log(se3.inverse(T_estimated) @ T_true)
    weighted = np.linalg.solve(covariance, epsilon[..., None])[..., 0]
    return np.asarray(np.sum(epsilon * weighted, axis=-1))


def nees_bounds(count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Between which the mean of `count` independent NEES lies with that probability, if all is
    right."""
    outside = 0.5 * (1.0 - confidence)
    low, high = (float(chi2.ppf(p, FREEDOM * count)) / count for p in (outside, 1.0 - outside))
    return low, high


def camera_nees(camera: CameraEstimates, truth: Trajectories, frame: Array) -> Array:
    """(N,) NEES of the camera's motions that end in the frames (M,) given, where it is stated."""
    k = frame[_stated(camera.step_covariance, frame)]
    if not len(k):
        return np.zeros(0)
    true_steps = se3.inverse(truth.T_world_camera[k - 1]) @ truth.T_world_camera[k]
    assert camera.step_covariance is not None
    return nees(camera.T_previous_camera[k], true_steps, camera.step_covariance[k])


def object_nees(motions: ObjectMotions, errors: Mapping[int, ObjectErrors],
                truth: Trajectories) -> Array:
    """(N,) NEES of the scored motions of rigid objects, seen from the camera before.

    The stated covariance is given the camera's pose, so that drift is no part of it; and of an
    object that deforms, no rigid motion is the truth.
    """
    parts = [np.zeros(0)]
    for true_id, each in errors.items():
        kept = _stated(motions.covariance, each.row) & np.isfinite(each.local_t_m)
        row, k = each.row[kept], each.frame[kept]
        if not (each.rigid and len(row)):
            continue
        assert motions.covariance is not None
        L, X = truth.objects[true_id].T_world_object, truth.T_world_camera[k - 1]
        H_true = se3.inverse(X) @ L[k] @ se3.inverse(L[k - 1]) @ X
        to_camera = se3.inverse(motions.T_world_camera[row])
        H = to_camera @ motions.H_world[row] @ motions.T_world_camera[row]
        A = se3.adjoint(to_camera)
        covariance = A @ motions.covariance[row] @ np.swapaxes(A, 1, 2)
        parts.append(nees(H, H_true, covariance))
    return np.concatenate(parts)


def consistency_metrics(camera: CameraEstimates, steps: MotionErrors, motions: ObjectMotions,
                        errors: Mapping[int, ObjectErrors], truth: Trajectories,
                        bounds: Bounds | None = None) -> dict[str, float]:
    """The block: NEES of both kinds with their bounds, and efficiencies where noise is known."""
    out = (_nees_block("camera", camera_nees(camera, truth, steps.frame))
           | _nees_block("objects", object_nees(motions, errors, truth)))
    return out if bounds is None else out | bounds.efficiencies(steps, errors)


def _nees_block(of: str, values: Array) -> dict[str, float]:
    """Mean, its bounds, and the share of single motions within their own bounds."""
    values = values[np.isfinite(values)]
    if not len(values):
        return {}
    low, high = nees_bounds(len(values))
    one = nees_bounds(1)
    inside = (values >= one[0]) & (values <= one[1])
    return {f"nees_{of}": float(values.mean()), f"nees_{of}_low": low, f"nees_{of}_high": high,
            f"nees_{of}_inside": float(inside.mean())}


def _stated(covariance: Array | None, index: Array) -> Array:
    if covariance is None:
        return np.zeros(len(index), dtype=bool)
    return np.asarray(np.isfinite(covariance[index]).all(axis=(1, 2)))
