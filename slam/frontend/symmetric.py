"""Many 2×2 matrices at once: symmetric ones as (3, N), uu, uv, vv; others as (2, 2, N)."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

DIAGONAL = np.array([[1.0], [0.0], [1.0]])   # the identity


def solve(matrix: Array, right: Array) -> Array:
    """(2, N) solutions of M x = r for M (3, N), r (2, N)."""
    uu, uv, vv = matrix
    determinant = np.maximum(uu * vv - uv * uv, 1e-12)
    return np.asarray(np.stack([vv * right[0] - uv * right[1],
                                uu * right[1] - uv * right[0]]) / determinant)


def quadratic(matrix: Array, x: Array) -> Array:
    """(N,) values of xᵀ M x for M (3, N), x (2, N)."""
    uu, uv, vv = matrix
    return np.asarray(uu * x[0] * x[0] + 2.0 * uv * x[0] * x[1] + vv * x[1] * x[1])


def full(matrix: Array) -> Array:
    """(2, 2, N) from (3, N)."""
    return np.asarray(matrix[[0, 1, 1, 2]].reshape(2, 2, -1))


def inverse(matrix: Array) -> Array:
    """Inverses of well-conditioned matrices (2, 2, N)."""
    (a, b), (c, d) = matrix
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)
