"""How se3.log answers to small motions: the right Jacobian of SE(3)."""

from __future__ import annotations

import numba
import numpy as np

from slam.geometry.arrays import Array
from slam.geometry.se3_rows import right_jacobian_row


def right_jacobian(xi: Array) -> Array:
    """J (..., 6, 6) with Exp(ξ + δ) ≈ Exp(ξ) Exp(J δ), of tangent vectors (..., 6) = [ω, v]."""
    xi = np.ascontiguousarray(xi, dtype=np.float64)
    return np.asarray(_rows(xi.reshape(-1, 6)).reshape(*xi.shape, 6))


def right_jacobian_inverse(xi: Array) -> Array:
    """J⁻¹ (..., 6, 6) with Log(T Exp(δ)) ≈ Log(T) + J⁻¹ δ, ξ = Log(T); singular only at 2π."""
    return np.asarray(np.linalg.inv(right_jacobian(xi)))


@numba.njit(cache=True)
def _rows(xi):  # type: ignore[no-untyped-def]
    out = np.empty((len(xi), 6, 6))
    for n in range(len(xi)):
        right_jacobian_row(xi[n], out[n])
    return out
