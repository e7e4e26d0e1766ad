"""How se3.log answers to small motions: the right Jacobian of SE(3)."""

from __future__ import annotations

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array

_TERMS = 32    # of the exponential series; at a rotation by π the last one is below 1e-18


def small_adjoint(xi: Array) -> Array:
    """ad_ξ (..., 6, 6) of tangent vectors (..., 6) = [ω, v]: the derivative of Ad_Exp(ξ) at 0."""
    xi = np.asarray(xi, dtype=np.float64)
    W = se3.skew(xi[..., :3])
    out = np.zeros((*xi.shape[:-1], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = W
    out[..., 3:, :3] = se3.skew(xi[..., 3:])
    return out


def right_jacobian(xi: Array) -> Array:
    """J (..., 6, 6) with Exp(ξ + δ) ≈ Exp(ξ) Exp(J δ): the series Σ (−ad_ξ)ⁿ / (n + 1)!."""
    minus = -small_adjoint(xi)
    term = np.broadcast_to(np.eye(6), minus.shape)
    total = np.array(term)
    for n in range(1, _TERMS):
        term = term @ minus / (n + 1.0)
        total += term
    return total


def right_jacobian_inverse(xi: Array) -> Array:
    """J⁻¹ (..., 6, 6) with Log(T Exp(δ)) ≈ Log(T) + J⁻¹ δ, ξ = Log(T); singular only at 2π."""
    return np.asarray(np.linalg.inv(right_jacobian(xi)))
