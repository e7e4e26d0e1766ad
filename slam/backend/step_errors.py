"""How the errors of tracked steps hang together, and what that leaves of their information.

Noise that belongs to places in frames enters the step to a frame and the step from it with
opposite signs: neighbouring steps correlate by −1/2 at most, and a path does not add the noise up.
Taken for independent, the same steps would seem to drift like a random walk.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.geometry.arrays import Array

# At 1/2, sums of many steps would be known exactly. Features come and go between steps, so that
# noise of places is never all of them: nine tenths are taken to be.
MOST_CORRELATION = 0.45
_LEAST_TIE = 1e-3           # over that of a step with itself: what is weaker is left out


def roots(information: Array) -> Array:
    """Symmetric roots R (N, 6, 6) of information matrices, Λ = R R; negative parts count as 0."""
    values, vectors = np.linalg.eigh(information)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(scaled @ np.swapaxes(vectors, 1, 2))


def ties(known: Array, correlation: float) -> Array:
    """Bands (N, D) of the inverse of the whitened steps' correlation matrix.

    That matrix has 1 on its diagonal and `correlation` beside it. Entry (k, d) of the answer ties
    steps k and k + d; ties fall off geometrically, and D is where they no longer count.

    Args:
        known: (N,) bool: steps that were tracked; errors of the others hang together with none.
        correlation: of a step's error with the next one's, between ±`MOST_CORRELATION`.
    """
    beside = np.where(known[:-1] & known[1:], correlation, 0.0)
    return np.asarray(_inverse_bands(beside, min(_reach(correlation), max(len(known), 1))))


def _reach(correlation: float) -> int:
    strength = abs(correlation)
    if strength < _LEAST_TIE:
        return 1
    ratio = (1.0 - np.sqrt(1.0 - 4.0 * strength**2)) / (2.0 * strength)
    return 1 + int(np.ceil(np.log(_LEAST_TIE) / np.log(ratio)))


@numba.njit(cache=True)
def _inverse_bands(beside, reach):  # type: ignore[no-untyped-def]
    """(N, reach) upper bands of the inverse of tridiagonal matrices with a unit diagonal."""
    n = len(beside) + 1
    pivot, Z = np.ones(n), np.zeros((n, reach))
    for k in range(1, n):
        pivot[k] = 1.0 - beside[k - 1] ** 2 / pivot[k - 1]
    Z[n - 1, 0] = 1.0 / pivot[n - 1]
    for k in range(n - 2, -1, -1):
        ratio = beside[k] / pivot[k]
        Z[k, 0] = 1.0 / pivot[k] + ratio * ratio * Z[k + 1, 0]
        for d in range(1, reach):
            Z[k, d] = -ratio * Z[k + 1, d - 1]
    return Z


@numba.njit(cache=True)
def cost_of_steps(r, root, tie):  # type: ignore[no-untyped-def]
    """Σ_kl t_kl z_kᵀ z_l of whitened residuals z = R r, of r (N, 6)."""
    z, total = _whitened(r, root), 0.0
    for k in range(len(r)):
        for d in range(min(tie.shape[1], len(r) - k)):
            along = 0.0
            for a in range(6):
                along += z[k, a] * z[k + d, a]
            total += (1.0 if d == 0 else 2.0) * tie[k, d] * along
    return total


@numba.njit(cache=True)
def add_steps(r, J_first, J_second, root, tie, S, g):  # type: ignore[no-untyped-def]
    """Add residuals (N, 6) of steps between successive poses to S (F, B, 6, 6) and g (F, 6).

    Args:
        J_first, J_second: (N, 6, 6) by the pose before and the pose after.
        root: (N, 6, 6) roots of the steps' information; tie: (N, D), D < B, as `ties` has them.
    """
    n, reach = tie.shape
    z, pulled = _whitened(r, root), np.zeros((n, 6))
    first, second = _product(root, J_first), _product(root, J_second)
    for k in range(n):
        for d in range(min(reach, n - k)):
            t = tie[k, d]
            if t == 0.0:
                continue
            for a in range(6):
                pulled[k, a] += t * z[k + d, a]
                if d > 0:
                    pulled[k + d, a] += t * z[k, a]
            _add_product(S[k, d], first[k], first[k + d], t)
            _add_product(S[k, d + 1], first[k], second[k + d], t)
            _add_product(S[k + 1, d], second[k], second[k + d], t)
            if d > 0:
                _add_product(S[k + 1, d - 1], second[k], first[k + d], t)
            if d == 1:                      # on the diagonal, which is stored whole
                _add_product(S[k + 1, 0], first[k + 1], second[k], t)
    for k in range(n):
        for a in range(6):
            for c in range(6):
                g[k, a] += first[k, c, a] * pulled[k, c]
                g[k + 1, a] += second[k, c, a] * pulled[k, c]


@numba.njit(cache=True)
def _whitened(r, root):  # type: ignore[no-untyped-def]
    z = np.zeros(r.shape)
    for k in range(len(r)):
        for a in range(6):
            for c in range(6):
                z[k, a] += root[k, a, c] * r[k, c]
    return z


@numba.njit(cache=True)
def _product(root, J):  # type: ignore[no-untyped-def]
    out = np.zeros(J.shape)
    for k in range(len(J)):
        _add_product(out[k], root[k], J[k], 1.0)      # a root is its own transpose
    return out


@numba.njit(cache=True)
def _add_product(out, left, right, weight):  # type: ignore[no-untyped-def]
    """Add weight · leftᵀ right to out."""
    for c in range(6):
        for a in range(6):
            v = weight * left[c, a]
            for b in range(6):
                out[a, b] += v * right[c, b]
