"""Covariances of the steps between successive poses, from the poses' normal equations."""

from __future__ import annotations

import numpy as np

from slam.backend.pose_system import one_thread
from slam.estimation.covariance import covariance_of
from slam.geometry import se3
from slam.geometry.arrays import Array


def step_covariances(S: Array, T: Array) -> Array:
    """Covariances (F, 6, 6) of the steps T_{k−1}⁻¹ T_k Exp(ξ) to each pose; NaN where unknown.

    The first pose is held, and has no step. With the blocks of the inverse's main diagonal and
    of the one beside it (the recursion of Takahashi on the banded factor), so that time grows with
    the number of poses.

    Args:
        S: (F, B, 6, 6) upper blocks (k, k + d) of the poses' normal equations, landmarks
            eliminated, undamped, as `Problem.reduced` gives them.
        T: (F, 4, 4) the poses.
    """
    F = len(S)
    out = np.full((F, 6, 6), np.nan)
    with one_thread():
        own, beside = _inverse_near_the_diagonal(S)
    A = -se3.adjoint(se3.inverse(se3.inverse(T[:-1]) @ T[1:]))
    for k in range(1, F):
        first, second, cross = own[k - 1], own[k], beside[k - 1]
        moved = A[k - 1] @ cross
        P = A[k - 1] @ first @ A[k - 1].T + moved + moved.T + second
        if np.isfinite(covariance_of(P)).all():
            out[k] = 0.5 * (P + P.T)
    return out


def _inverse_near_the_diagonal(S: Array) -> tuple[Array, Array]:
    """Blocks (k, k) and (k, k + 1) of the inverse, the first pose held; NaN where singular.

    Block elimination: S = L D Lᵀ with unit lower L; for Z = S⁻¹, Z = D⁻¹ + (I − Lᵀ) Z, which needs
    only the blocks of Z within the band.
    """
    F, B = S.shape[:2]
    U = np.array(S)                                  # row k: U[k, d], d = 0 … B − 1
    for k in range(F):                               # diagonal blocks are stored whole or upper
        U[k, 0] = 0.5 * (U[k, 0] + U[k, 0].T)
    U[0] = 0.0
    U[0, 0] = np.eye(6)
    inverse = np.empty((F, 6, 6))
    for k in range(F):
        pivot = covariance_of(U[k, 0])
        if not np.isfinite(pivot).all():
            return np.full((F, 6, 6), np.nan), np.full((F, 6, 6), np.nan)
        inverse[k] = pivot
        reach = min(B, F - k)
        row = U[k, 1:reach].copy()
        scaled = pivot @ row                         # (reach − 1, 6, 6) = Lᵀ's blocks
        for d in range(1, reach):
            U[k + d, :reach - d] -= row[d - 1].T @ scaled[d - 1:]
        U[k, 1:reach] = scaled
    Z = np.zeros((F, B, 6, 6))
    for k in range(F - 1, -1, -1):
        reach = min(B, F - k)
        for d in range(1, reach):                    # Z[k, k+d] = −Σ_e Lᵀ[k, e] Z[k+e, k+d]
            to = np.arange(1, d + 1)
            Z[k, d] = -(np.sum(U[k, to] @ Z[k + to, d - to], axis=0) + np.sum(
                U[k, d + 1:reach] @ np.swapaxes(Z[k + d, 1:reach - d], 1, 2), axis=0))
        Z[k, 0] = inverse[k]
        for e in range(1, reach):
            Z[k, 0] -= U[k, e] @ Z[k, e].T
    Z[0] = 0.0                                       # held: it does not err
    return Z[:, 0], Z[:, 1] if B > 1 else np.zeros((F, 6, 6))
