"""Covariances of motions, from the information that their estimation ended with.

All tangents are [ω, v] and perturb on the right, T Exp(ξ).
"""

from __future__ import annotations

import numba
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array

_SMALLEST_EIGENVALUE = 1e-10    # of the information scaled to a unit diagonal; below: singular


def covariance_of(information: Array) -> Array | None:
    """Inverse (6, 6) of an information matrix; None where it leaves a direction unknown."""
    information = np.asarray(information, dtype=np.float64)
    diagonal = np.diagonal(information)
    if not (np.isfinite(information).all() and np.all(diagonal > 0.0)):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if values[0] < _SMALLEST_EIGENVALUE:
        return None
    half = scale[:, None] * vectors / np.sqrt(values)
    return np.asarray(half @ half.T)


def moved_covariance(T: Array, covariance: Array) -> Array:
    """Covariance (..., 6, 6) of T A T⁻¹ from that of A: Ad_T P Ad_Tᵀ.

    Args:
        T: (..., 4, 4); covariance: (..., 6, 6) of A Exp(ξ).
    """
    A = se3.adjoint(T)
    return np.asarray(A @ covariance @ np.swapaxes(A, -1, -2))


def object_covariance(T_world_a: Array, T_a_b_object: Array, camera: Array | None,
                      body: Array | None) -> Array | None:
    """Covariance (6, 6) of an object's motion H Exp(ξ) in the world, the camera's pose at a given.

    H = X_a T_a_b(camera) T_a_b(object)⁻¹ X_a⁻¹: both poses err, by independent features, and both
    errors stand in camera b.

    Args:
        T_world_a: (4, 4) of the camera before; what is unknown of it is not in this covariance.
        T_a_b_object: (4, 4) the camera's pose b in a as the object sees it.
        camera, body: (6, 6) covariances of T_a_b as the static world and the object see it;
            None where unknown.
    """
    if camera is None or body is None:
        return None
    return moved_covariance(T_world_a @ T_a_b_object, camera + body)


@numba.njit(cache=True, nogil=True)
def sharing(uv_px, group, groups, width_px):  # type: ignore[no-untyped-def]
    """By how much (G,) windows that overlap claim too much information.

    Windows of one motion that share pixels share these pixels' errors. Each counts for the share
    of its area in which it stands alone: n windows hold n / m independent ones, with m the mean
    over the windows of Σ_j (overlap with window j) / area, itself included.

    Args:
        uv_px: (N, 2) middles of square windows of side width_px; group: (N,) the motion of each.
    """
    total, count = np.zeros(groups), np.zeros(groups)
    order = np.argsort(uv_px[:, 1])
    for a in range(len(order)):
        i = order[a]
        total[group[i]] += 1.0
        count[group[i]] += 1.0
        for b in range(a + 1, len(order)):
            j = order[b]
            v = 1.0 - (uv_px[j, 1] - uv_px[i, 1]) / width_px
            if v <= 0.0:
                break
            u = 1.0 - abs(uv_px[j, 0] - uv_px[i, 0]) / width_px
            if u > 0.0 and group[i] == group[j]:
                total[group[i]] += 2.0 * u * v
    return np.where(count > 0.0, total / np.maximum(count, 1.0), 1.0)
