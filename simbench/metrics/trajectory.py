"""ATE and RPE by the TUM definitions (DPL-SLAM eq. 5 and 6)."""

from __future__ import annotations

import numpy as np

from simbench.metrics.motion import motion_errors
from slam.geometry import se3
from slam.geometry.arrays import Array


def rigid_alignment(points_from: Array, points_to: Array) -> Array:
    """The (4, 4) motion without scale that best carries points (N, 3) onto points (N, 3).

    Umeyama 1991 with scale 1, N ≥ 1.
    """
    mean_from, mean_to = points_from.mean(axis=0), points_to.mean(axis=0)
    U, _, Vt = np.linalg.svd((points_to - mean_to).T @ (points_from - mean_from))
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ D @ Vt
    return np.asarray(se3.from_rotation_translation(R, mean_to - R @ mean_from))


def ate_errors(T_estimated: Array, T_true: Array) -> Array:
    """(N,) position errors in metres of poses (N, 4, 4) after SE(3) alignment, scale 1."""
    positions = T_estimated[:, :3, 3]
    T_true_estimated = rigid_alignment(positions, T_true[:, :3, 3])
    aligned = se3.transform_points(T_true_estimated, positions)
    return np.asarray(np.linalg.norm(aligned - T_true[:, :3, 3], axis=-1))


def rpe_errors(T_estimated: Array, T_true: Array, pairs: Array) -> tuple[Array, Array]:
    """Relative pose errors (T̂_i⁻¹ T̂_j)⁻¹ (T_i⁻¹ T_j) over index pairs (i, j).

    Args:
        T_estimated, T_true: (K, 4, 4) poses.
        pairs: (P, 2). Swapped pairs measure the motion backward: the angle is the same, the
            translation differs a little, since it is then seen from the other end.
    Returns:
        (P,) metres and (P,) degrees.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    return motion_errors(se3.inverse(T_estimated[i]) @ T_estimated[j],
                         se3.inverse(T_true[i]) @ T_true[j])


def frame_pairs(count: int, delta: int) -> Array:
    """(P, 2) every pair of frames `delta` apart."""
    first = np.arange(max(0, count - delta))
    return np.stack([first, first + delta], axis=-1)


def time_pairs(stamps_s: Array, delta_s: float) -> Array:
    """(P, 2) each pose with the one nearest to delta_s later, for ascending stamps (K,).

    As in the TUM benchmark's script, a pose whose partner would be the last of all is left out:
    its true partner may lie beyond the end.
    """
    stamps_s = np.asarray(stamps_s, dtype=np.float64)
    count = len(stamps_s)
    if count < 3:
        return np.zeros((0, 2), dtype=np.int64)
    wanted = stamps_s + delta_s
    after = np.clip(np.searchsorted(stamps_s, wanted), 1, count - 1)
    nearer_before = wanted - stamps_s[after - 1] <= stamps_s[after] - wanted
    partner = np.where(nearer_before, after - 1, after)
    first = np.arange(count)
    keep = (partner < count - 1) & (partner > first)
    return np.stack([first[keep], partner[keep]], axis=-1)


def statistics(errors: Array) -> dict[str, float]:
    """rmse, mean, median and (population) std of errors (N,), N ≥ 1."""
    return {"rmse": float(np.sqrt(np.mean(errors ** 2))), "mean": float(np.mean(errors)),
            "median": float(np.median(errors)), "std": float(np.std(errors))}
