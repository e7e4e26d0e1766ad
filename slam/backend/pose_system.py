"""The poses' normal equations: quadratic terms, and their solution."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import cast

import numba
import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from threadpoolctl import ThreadpoolController

from slam.geometry.arrays import Array

_SMALL_SYSTEM = 100    # unknowns, up to which calling a library takes longer than the solution


@numba.njit(cache=True)
def quadratic(off, information, pull):  # type: ignore[no-untyped-def]
    """Σ dᵀ Λ d of vectors d (N, D) and information (N, D, D); fills pull (N, D) with Λ d."""
    total = 0.0
    for n in range(len(off)):
        for i in range(off.shape[1]):
            along = 0.0
            for j in range(off.shape[1]):
                along += information[n, i, j] * off[n, j]
            pull[n, i] = along
            total += along * off[n, i]
    return total


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


@numba.njit(cache=True)
def _solve_small(ab, b):  # type: ignore[no-untyped-def]
    """Solution of a lower banded system, which is destroyed; False if it is not positive."""
    width, n = ab.shape
    for j in range(n):
        if not ab[0, j] > 0.0:
            return False
        reach = min(width, n - j)
        scale = 1.0 / np.sqrt(ab[0, j])
        for i in range(reach):
            ab[i, j] *= scale
        for c in range(1, reach):
            v = ab[c, j]
            for i in range(c, reach):
                ab[i - c, j + c] -= v * ab[i, j]
    for j in range(n):
        b[j] /= ab[0, j]
        for i in range(1, min(width, n - j)):
            b[j + i] -= ab[i, j] * b[j]
    for j in range(n - 1, -1, -1):
        for i in range(1, min(width, n - j)):
            b[j] -= ab[i, j] * b[j + i]
        b[j] /= ab[0, j]
    return True


@cache
def _threads() -> ThreadpoolController:
    """Made once: looking for the libraries takes long."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """BLAS on one thread: how a factorisation is cut up among threads changes its last bits."""
    return cast(AbstractContextManager[object], _threads().limit(limits=1))


def solve_poses(S: Array, g: Array, damping: float) -> Array | None:
    """Pose steps (F, 6) of S x = −g, damped; None if the system is not positive definite."""
    ab, step = _banded(S, damping), -g.reshape(-1)
    if len(step) <= _SMALL_SYSTEM:
        solved = _solve_small(ab, step)
        return step.reshape(-1, 6) if solved and np.isfinite(step).all() else None
    with one_thread():
        try:
            step = cho_solve_banded((cholesky_banded(ab, lower=True), True), step)
        except (LinAlgError, ValueError):
            return None
    return step.reshape(-1, 6) if np.isfinite(step).all() else None
