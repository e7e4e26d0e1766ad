"""Normal equations of poses and point landmarks, and their reduction to the poses.

Sightings are sorted by landmark. A landmark's 3×3 block is inverted in closed form; what is left
couples the poses that see a landmark in common: blocks (k, k + d) for d up to the longest track.
"""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from threadpoolctl import ThreadpoolController

from slam.factors import landmark_row
from slam.geometry.arrays import Array

_UNSEEN_CHI2 = 1e6     # what a point costs that its pose cannot see


@numba.njit(cache=True)
def linearise(T, xyz, pose, landmark, uv, rho, whitening, camera, width,  # type: ignore[no-untyped-def]
              rw, Jw, Vw):
    """Fill the weighted whitened residuals (M, 3) and derivatives (M, 3, 6), (M, 3, 3).

    Args:
        whitening: (M, 4): the lower triangle of L⁻¹ (uu, vu, vv) of the pixel, 1/σ of ρ.
        width: of Cauchy's kernel.
    Returns:
        the objective; chi2 (M,), each sighting's squared whitened length, inf where unseen.
    """
    chi2 = np.empty(len(pose))
    cost = 0.0
    r, J, V = np.empty(3), np.zeros((3, 6)), np.empty((3, 3))
    for i in range(len(pose)):
        if not landmark_row(T[pose[i]], xyz[landmark[i]], uv[i], rho[i], camera, r, J, V):
            rw[i] = 0.0
            Jw[i] = 0.0
            Vw[i] = 0.0
            chi2[i] = np.inf
            cost += width * width * np.log1p(_UNSEEN_CHI2 / (width * width))
            continue
        l00, l10, l11, l22 = whitening[i]
        total = 0.0
        rw[i, 0] = l00 * r[0]
        rw[i, 1] = l10 * r[0] + l11 * r[1]
        rw[i, 2] = l22 * r[2]
        for a in range(3):
            total += rw[i, a] * rw[i, a]
        chi2[i] = total
        weight = np.sqrt(1.0 / (1.0 + total / (width * width)))
        cost += width * width * np.log1p(total / (width * width))
        for c in range(6):
            Jw[i, 0, c] = weight * l00 * J[0, c]
            Jw[i, 1, c] = weight * (l10 * J[0, c] + l11 * J[1, c])
            Jw[i, 2, c] = weight * l22 * J[2, c]
        for c in range(3):
            Vw[i, 0, c] = weight * l00 * V[0, c]
            Vw[i, 1, c] = weight * (l10 * V[0, c] + l11 * V[1, c])
            Vw[i, 2, c] = weight * l22 * V[2, c]
        for a in range(3):
            rw[i, a] *= weight
    return cost, chi2


@numba.njit(cache=True)
def reduce_landmarks(pose, start, rw, Jw, Vw, known, pull, damping, S, g,  # type: ignore[no-untyped-def]
                     inverse, gradient):
    """Add sightings, landmarks eliminated, to S (F, B, 6, 6) and g (F, 6).

    Args:
        start: (P + 1,) where each landmark's sightings begin.
        known, pull: (P, 3, 3), (P, 3): information held of each landmark beside its sightings,
            and that information times how far the landmark is from where it would have it.
        damping: Marquardt's factor on the landmarks' diagonals.
        inverse, gradient: (P, 3, 3), (P, 3): filled, for `landmark_steps`.
    """
    longest = 0
    for p in range(len(start) - 1):
        longest = max(longest, start[p + 1] - start[p])
    W, A = np.empty((longest, 3, 6)), np.empty((3, 6))
    for p in range(len(start) - 1):
        first, last = start[p], start[p + 1]
        _own_block(Vw[first:last], rw[first:last], known[p], pull[p], damping, inverse[p],
                   gradient[p])
        _couplings(Vw[first:last], Jw[first:last], W)
        for i in range(first, last):
            k = pose[i]
            own = S[k, 0]
            for c in range(3):
                for a in range(6):
                    A[c, a] = (W[i - first, 0, a] * inverse[p, 0, c]
                               + W[i - first, 1, a] * inverse[p, 1, c]
                               + W[i - first, 2, a] * inverse[p, 2, c])
            for row in range(3):
                for a in range(6):
                    g[k, a] += Jw[i, row, a] * rw[i, row] - A[row, a] * gradient[p, row]
                    for c in range(6):
                        own[a, c] += Jw[i, row, a] * Jw[i, row, c]
            for j in range(i, last):
                block, other = S[k, pose[j] - k], W[j - first]
                for a in range(6):
                    a0, a1, a2 = A[0, a], A[1, a], A[2, a]
                    for c in range(6):           # innermost and contiguous: it vectorises
                        block[a, c] -= a0 * other[0, c] + a1 * other[1, c] + a2 * other[2, c]


@numba.njit(cache=True)
def _couplings(V, J, W):  # type: ignore[no-untyped-def]
    """Fill W (≥ N, 3, 6) with Vᵀ J of the N sightings of a landmark."""
    for i in range(len(V)):
        for c in range(3):
            for a in range(6):
                W[i, c, a] = (V[i, 0, c] * J[i, 0, a] + V[i, 1, c] * J[i, 1, a]
                              + V[i, 2, c] * J[i, 2, a])


@numba.njit(cache=True)
def _own_block(V, r, known, pull, damping, inverse, gradient):  # type: ignore[no-untyped-def]
    """Inverse of the damped 3×3 block of one landmark, and its gradient."""
    C = known.copy()
    gradient[:] = pull
    for i in range(len(V)):
        for row in range(3):
            for a in range(3):
                gradient[a] += V[i, row, a] * r[i, row]
                for c in range(3):
                    C[a, c] += V[i, row, a] * V[i, row, c]
    trace = C[0, 0] + C[1, 1] + C[2, 2]
    for a in range(3):
        C[a, a] += damping * C[a, a] + 1e-12 * trace + 1e-30
    _invert(C, inverse)


@numba.njit(cache=True)
def landmark_steps(pose, start, Jw, Vw, inverse, gradient, pose_step):  # type: ignore[no-untyped-def]
    """Steps (P, 3) of the landmarks that go with steps (F, 6) of the poses."""
    out = np.empty((len(start) - 1, 3))
    moved = np.empty(3)
    for p in range(len(start) - 1):
        b = gradient[p].copy()
        for i in range(start[p], start[p + 1]):
            for row in range(3):
                moved[row] = 0.0
                for c in range(6):
                    moved[row] += Jw[i, row, c] * pose_step[pose[i], c]
            for a in range(3):
                for row in range(3):
                    b[a] += Vw[i, row, a] * moved[row]
        for a in range(3):
            out[p, a] = -(inverse[p, a, 0] * b[0] + inverse[p, a, 1] * b[1]
                          + inverse[p, a, 2] * b[2])
    return out


@numba.njit(cache=True, inline="always")
def _invert(C, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive 3×3 matrix."""
    a00 = C[1, 1] * C[2, 2] - C[1, 2] * C[1, 2]
    a01 = C[0, 2] * C[1, 2] - C[0, 1] * C[2, 2]
    a02 = C[0, 1] * C[1, 2] - C[0, 2] * C[1, 1]
    det = C[0, 0] * a00 + C[0, 1] * a01 + C[0, 2] * a02
    d = 1.0 / det if det > 0.0 else 0.0
    out[0, 0], out[0, 1], out[0, 2] = a00 * d, a01 * d, a02 * d
    out[1, 1] = (C[0, 0] * C[2, 2] - C[0, 2] * C[0, 2]) * d
    out[1, 2] = (C[0, 1] * C[0, 2] - C[0, 0] * C[1, 2]) * d
    out[2, 2] = (C[0, 0] * C[1, 1] - C[0, 1] * C[0, 1]) * d
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@numba.njit(cache=True)
def _banded(S, damping):  # type: ignore[no-untyped-def]
    """Lower banded form (6 B, 6 F) of the damped system."""
    F, B = S.shape[:2]
    ab = np.zeros((6 * B, 6 * F))
    for k in range(F):
        for d in range(min(B, F - k)):
            for a in range(6):
                for c in range(6):
                    row, column = 6 * (k + d) + c, 6 * k + a      # block (k, k+d), transposed
                    if row >= column:
                        ab[row - column, column] = S[k, d, a, c]
        for a in range(6):
            ab[0, 6 * k + a] += damping * ab[0, 6 * k + a] + 1e-12
    return ab


@cache
def _threads() -> ThreadpoolController:
    """Made once: looking for the libraries takes longer than a window's solution."""
    return ThreadpoolController()


def solve_poses(S: Array, g: Array, damping: float) -> Array | None:
    """Pose steps (F, 6) of S x = −g, damped; None if the system is not positive definite."""
    # One thread: how a factorisation is cut up among threads changes its last bits.
    with _threads().limit(limits=1):
        try:
            factor = cholesky_banded(_banded(S, damping), lower=True)
        except (LinAlgError, ValueError):
            return None
        step = cho_solve_banded((factor, True), -g.reshape(-1))
    return step.reshape(-1, 6) if np.isfinite(step).all() else None
