"""Normal equations of poses and landmarks, and their reduction to the poses.

A landmark is a point of 3 parameters or a line of 4, and a sighting of it as many residuals.
Sightings are sorted by landmark. A landmark's own block is inverted; what is left couples the
poses that see a landmark in common: blocks (k, k + d) for d up to the longest track.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def reduce_landmarks(pose, start, rw, Jw, Vw, known, pull, damping, S, g,  # type: ignore[no-untyped-def]
                     inverse, gradient):
    """Add sightings, landmarks of D parameters eliminated, to S (F, B, 6, 6) and g (F, 6).

    Args:
        start: (P + 1,) where each landmark's sightings begin.
        rw, Jw, Vw: (M, R), (M, R, 6), (M, R, D) weighted whitened residuals and derivatives.
        known, pull: (P, D, D), (P, D): information held of each landmark beside its sightings,
            and that information times how far the landmark is from where it would have it.
        damping: Marquardt's factor on the landmarks' diagonals.
        inverse, gradient: (P, D, D), (P, D): filled, for `landmark_steps`.
    """
    rows, size = Vw.shape[1], Vw.shape[2]
    longest = 0
    for p in range(len(start) - 1):
        longest = max(longest, start[p + 1] - start[p])
    W, A = np.empty((longest, size, 6)), np.empty((size, 6))
    C, room = np.empty((size, size)), np.empty((size, size))
    for p in range(len(start) - 1):
        first, last = start[p], start[p + 1]
        _own_block(Vw[first:last], rw[first:last], known[p], pull[p], damping, C, gradient[p])
        invert(C, room, inverse[p])
        _couplings(Vw[first:last], Jw[first:last], W)
        for i in range(first, last):
            k = pose[i]
            own = S[k, 0]
            _product(inverse[p], W[i - first], A)
            for a in range(6):
                for c in range(size):
                    g[k, a] -= A[c, a] * gradient[p, c]
                for row in range(rows):
                    v = Jw[i, row, a]
                    g[k, a] += v * rw[i, row]
                    for c in range(6):
                        own[a, c] += v * Jw[i, row, c]
            for j in range(i, last):
                block, other = S[k, pose[j] - k], W[j - first]
                for d in range(size):
                    for a in range(6):
                        v = A[d, a]
                        for c in range(6):       # innermost and contiguous: it vectorises
                            block[a, c] -= v * other[d, c]


@numba.njit(cache=True)
def _product(inverse, W, A):  # type: ignore[no-untyped-def]
    """Fill A (D, 6) with a symmetric matrix (D, D) times W (D, 6)."""
    A[:] = 0.0
    for c in range(len(A)):
        for d in range(len(A)):
            v = inverse[d, c]
            for a in range(6):
                A[c, a] += v * W[d, a]


@numba.njit(cache=True)
def _couplings(V, J, W):  # type: ignore[no-untyped-def]
    """Fill W (≥ N, D, 6) with Vᵀ J of the N sightings of a landmark."""
    for i in range(len(V)):
        W[i] = 0.0
        for row in range(V.shape[1]):
            for c in range(V.shape[2]):
                v = V[i, row, c]
                for a in range(6):
                    W[i, c, a] += v * J[i, row, a]


@numba.njit(cache=True)
def _own_block(V, r, known, pull, damping, C, gradient):  # type: ignore[no-untyped-def]
    """Damped block C (D, D) of one landmark, and its gradient."""
    size = V.shape[2]
    C[:] = known
    gradient[:] = pull
    for i in range(len(V)):
        for row in range(V.shape[1]):
            for a in range(size):
                v = V[i, row, a]
                gradient[a] += v * r[i, row]
                for c in range(size):
                    C[a, c] += v * V[i, row, c]
    trace = 0.0
    for a in range(size):
        trace += C[a, a]
    for a in range(size):
        C[a, a] += damping * C[a, a] + 1e-12 * trace + 1e-30


@numba.njit(cache=True)
def landmark_steps(pose, start, Jw, Vw, inverse, gradient, pose_step):  # type: ignore[no-untyped-def]
    """Steps (P, D) of the landmarks that go with steps (F, 6) of the poses."""
    rows, size = Vw.shape[1], Vw.shape[2]
    out = np.zeros((len(start) - 1, size))
    b = np.empty(size)
    for p in range(len(start) - 1):
        b[:] = gradient[p]
        for i in range(start[p], start[p + 1]):
            for row in range(rows):
                moved = 0.0
                for c in range(6):
                    moved += Jw[i, row, c] * pose_step[pose[i], c]
                for a in range(size):
                    b[a] += Vw[i, row, a] * moved
        for a in range(size):
            for c in range(size):
                out[p, a] -= inverse[p, a, c] * b[c]
    return out


@numba.njit(cache=True)
def invert(C, L, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive matrix (D, D), by Cholesky; 0 where it is not positive.

    Args:
        L: (D, D) room.
    """
    size = len(C)
    out[:] = 0.0
    for i in range(size):
        for j in range(i + 1):
            total = C[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total * L[j, j]
            elif total > 0.0:
                L[i, i] = 1.0 / np.sqrt(total)        # the inverse of the diagonal
            else:
                return
    for i in range(size):                             # L⁻¹ in place, then its square
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total += L[i, k] * L[k, j]
            L[i, j] = -total * L[i, i]
    for i in range(size):
        for j in range(size):
            for k in range(max(i, j), size):
                out[i, j] += L[k, i] * L[k, j]
