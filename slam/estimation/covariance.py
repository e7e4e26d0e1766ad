"""Covariances of motions, from the information that their estimation ended with.

All tangents are [ω, v] and perturb on the right, T Exp(ξ).
"""

from __future__ import annotations

import numba
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array

_SMALLEST_EIGENVALUE = 1e-10    # of the information scaled to a unit diagonal; below: singular


def covariance_of(information: Array) -> Array:
    """Inverses (..., 6, 6) of information matrices; NaN where one leaves a direction unknown."""
    information = np.asarray(information, dtype=np.float64)
    diagonal = np.diagonal(information, axis1=-2, axis2=-1)
    known = np.isfinite(information).all(axis=(-2, -1)) & np.all(diagonal > 0.0, axis=-1)
    usable = np.where(known[..., None, None], information, np.eye(6))
    scale = 1.0 / np.sqrt(np.where(known[..., None], diagonal, 1.0))
    values, vectors = np.linalg.eigh(usable * scale[..., :, None] * scale[..., None, :])
    known &= values[..., 0] >= _SMALLEST_EIGENVALUE
    values = np.where(known[..., None], values, np.nan)
    half = scale[..., :, None] * vectors / np.sqrt(values)[..., None, :]
    return np.asarray(half @ np.swapaxes(half, -1, -2))


def known_or_none(covariance: Array) -> Array | None:
    """What an estimate carries of a covariance (6, 6): None where it is not known."""
    return covariance if np.isfinite(covariance).all() else None


def moved_covariance(T: Array, covariance: Array) -> Array:
    """Covariance (..., 6, 6) of T A T⁻¹ from that of A: Ad_T P Ad_Tᵀ.

    Args:
        T: (..., 4, 4); covariance: (..., 6, 6) of A Exp(ξ).
    """
    A = se3.adjoint(T)
    return np.asarray(A @ covariance @ np.swapaxes(A, -1, -2))


def object_covariance(T_world_a: Array, T_a_b_object: Array, camera: Array,
                      body: Array) -> Array:
    """Covariances (..., 6, 6) of objects' motions H Exp(ξ) in the world, camera a given.

    H = X_a T_a_b(camera) T_a_b(object)⁻¹ X_a⁻¹: both poses err, by independent features, and both
    errors stand in camera b.

    Args:
        T_world_a: (4, 4) of the camera before; what is unknown of it is not in this covariance.
        T_a_b_object: (..., 4, 4) the camera's pose b in a as the object sees it.
        camera: (6, 6) covariance of T_a_b as the static world sees it.
        body: (..., 6, 6) the same as each object sees it.
    """
    return moved_covariance(T_world_a @ T_a_b_object, camera + body)


def rotation_sigma(information: Array) -> Array:
    """(...) rad: standard deviation of a rotation, over all axes, by information (..., 6, 6)."""
    variance = np.linalg.inv(information + np.eye(6) * 1e-6)
    return np.asarray(np.sqrt(np.trace(variance[..., :3, :3], axis1=-2, axis2=-1)))


def clustering(information: Array, score: Array) -> float:
    """By how much errors that near features have in common widen a motion's variance.

    Were all errors independent, the scores Σ w Jᵀr of parts of the image would spread as the
    parts' information says; what they spread more is the design effect (Liang & Zeger 1986). The
    scores are those of the solution, which they have made sum to zero: of a part that holds H_c of
    the whole information H, H_c − H_c H⁻¹ H_c is left.

    Args:
        information: (C, 6, 6) Σ w JᵀJ of each part; score: (C, 6), in units of independent
            features' standard deviations.
    Returns:
        the mean over the motion's directions; 1 where the parts cannot tell.
    """
    total = covariance_of(information.sum(axis=0))
    share = total @ information
    expected = float(len(total) - np.einsum("cij,cji->", share, share))
    found = float(np.einsum("ci,ij,cj->", score, total, score))
    return found / expected if expected > 1.0 and np.isfinite(found) else 1.0


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
    for own in range(groups):
        places = uv_px[order[group[order] == own]]
        count[own] = total[own] = len(places)
        for i in range(len(places)):
            for j in range(i + 1, len(places)):
                v = 1.0 - (places[j, 1] - places[i, 1]) / width_px
                if v <= 0.0:
                    break
                u = 1.0 - abs(places[j, 0] - places[i, 0]) / width_px
                if u > 0.0:
                    total[own] += 2.0 * u * v
    return np.where(count > 0.0, total / np.maximum(count, 1.0), 1.0)
