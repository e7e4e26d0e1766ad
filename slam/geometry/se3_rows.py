"""Rigid motions one at a time, for compiled loops: what `slam.geometry.se3` does with arrays.

A window of a few poses is too small for array calls to be worth their start; loops over compiled
functions are a hundred times as fast there.
"""

from __future__ import annotations

import numba
import numpy as np

_SMALL_ANGLE_SQUARED = 1e-8
_TERMS = 32       # of the exponential series; at a rotation by π the last one is below 1e-18
_NOTHING = 1e-18  # a term below it changes no bit of the sum


@numba.njit(cache=True, nogil=True)
def exp_row(xi, T):  # type: ignore[no-untyped-def]
    """Fill T (4, 4) with Exp of a tangent vector (6,) = [ω rad, v m]."""
    x, y, z = xi[0], xi[1], xi[2]
    a, b, c = _series(x * x + y * y + z * z)
    _fill_rotation(x, y, z, a, b, T)
    u, v, w = xi[3], xi[4], xi[5]
    # ω × v and ω × (ω × v).
    p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
    T[0, 3] = u + b * p + c * (y * r - z * q)
    T[1, 3] = v + b * q + c * (z * p - x * r)
    T[2, 3] = w + b * r + c * (x * q - y * p)
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0


@numba.njit(cache=True, nogil=True)
def exp_so3_row(w, R):  # type: ignore[no-untyped-def]
    """Fill the upper left 3×3 of R with the rotation by a vector (3,) in radians."""
    a, b, _ = _series(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    _fill_rotation(w[0], w[1], w[2], a, b, R)


@numba.njit(cache=True, nogil=True, inline="always")
def _fill_rotation(x, y, z, a, b, R):  # type: ignore[no-untyped-def]
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@numba.njit(cache=True, nogil=True, inline="always")
def _series(t2):  # type: ignore[no-untyped-def]
    """sin θ/θ, (1−cos θ)/θ², (θ−sin θ)/θ³ of θ²."""
    if t2 < _SMALL_ANGLE_SQUARED:
        return 1.0 - t2 / 6.0, 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0
    t = np.sqrt(t2)
    half = np.sin(0.5 * t)
    return np.sin(t) / t, 2.0 * half * half / t2, (t - np.sin(t)) / (t2 * t)


@numba.njit(cache=True, nogil=True)
def log_so3_row(R, w):  # type: ignore[no-untyped-def]
    """Fill w (3,) with the rotation vector of R's upper left 3×3; exact near 0 and near π."""
    xx, yy = 1.0 + R[0, 0] - R[1, 1] - R[2, 2], 1.0 - R[0, 0] + R[1, 1] - R[2, 2]
    zz, ww = 1.0 - R[0, 0] - R[1, 1] + R[2, 2], 1.0 + R[0, 0] + R[1, 1] + R[2, 2]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    xw, yw, zw = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    # The rows of 4 q qᵀ: the one with the largest diagonal element is well conditioned.
    most = max(xx, yy, zz, ww)
    if ww == most:
        q0, q1, q2, q3 = xw, yw, zw, ww
    elif xx == most:
        q0, q1, q2, q3 = xx, xy, xz, xw
    elif yy == most:
        q0, q1, q2, q3 = xy, yy, yz, yw
    else:
        q0, q1, q2, q3 = xz, yz, zz, zw
    if q3 < 0.0:
        q0, q1, q2, q3 = -q0, -q1, -q2, -q3
    n = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2)
    scale = 2.0 * np.arctan2(n, q3) / n if n > 1e-12 * most else 2.0 / q3
    w[0], w[1], w[2] = q0 * scale, q1 * scale, q2 * scale


@numba.njit(cache=True, nogil=True)
def log_row(T, xi):  # type: ignore[no-untyped-def]
    """Fill xi (6,) with Log of a transform (4, 4)."""
    log_so3_row(T, xi)
    x, y, z = xi[0], xi[1], xi[2]
    t2 = x * x + y * y + z * z
    a, b, _ = _series(t2)
    # V⁻¹ = I − ½ ω× + d ω× ω×, d = (1 − a / (2 b)) / θ².
    d = 1.0 / 12.0 + t2 / 720.0 if t2 < 1e-4 else (1.0 - a / (2.0 * b)) / t2
    u, v, w = T[0, 3], T[1, 3], T[2, 3]
    p, q, r = y * w - z * v, z * u - x * w, x * v - y * u
    xi[3] = u - 0.5 * p + d * (y * r - z * q)
    xi[4] = v - 0.5 * q + d * (z * p - x * r)
    xi[5] = w - 0.5 * r + d * (x * q - y * p)


@numba.njit(cache=True, nogil=True)
def right_jacobian_row(xi, J):  # type: ignore[no-untyped-def]
    """Fill J (6, 6) with Exp(ξ + δ) ≈ Exp(ξ) Exp(J δ): the series Σ (−ad_ξ)ⁿ / (n + 1)!."""
    minus, term, following = np.zeros((6, 6)), np.eye(6), np.empty((6, 6))
    for half in range(2):
        _add_skew(minus, 3 * half, 3 * half, xi[0], xi[1], xi[2])
    _add_skew(minus, 3, 0, xi[3], xi[4], xi[5])
    J[:] = term
    for n in range(1, _TERMS):
        largest = 0.0
        for i in range(6):
            for j in range(6):
                total = 0.0
                for k in range(6):
                    total += term[i, k] * minus[k, j]
                following[i, j] = total / (n + 1.0)
                largest = max(largest, abs(following[i, j]))
        term[:] = following
        J += term
        if not largest > _NOTHING:
            return


@numba.njit(cache=True, nogil=True)
def _add_skew(M, i, j, x, y, z):  # type: ignore[no-untyped-def]
    """Fill the 3×3 at (i, j) with −[x, y, z]×."""
    M[i, j + 1], M[i, j + 2], M[i + 1, j + 2] = z, -y, x
    M[i + 1, j], M[i + 2, j], M[i + 2, j + 1] = -z, y, -x


@numba.njit(cache=True, nogil=True)
def between_row(A, B, out):  # type: ignore[no-untyped-def]
    """Fill out (4, 4) with A⁻¹ B."""
    for i in range(3):
        for j in range(4):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
        out[i, 3] -= A[0, i] * A[0, 3] + A[1, i] * A[1, 3] + A[2, i] * A[2, 3]
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@numba.njit(cache=True, nogil=True)
def moved_rows(T, xi):  # type: ignore[no-untyped-def]
    """T Exp(ξ) of transforms (N, 4, 4) and tangent vectors (N, 6), rotations kept orthonormal."""
    out, step = np.zeros_like(T), np.empty((4, 4))
    for n in range(len(T)):
        exp_row(xi[n], step)
        for i in range(3):
            for j in range(4):
                out[n, i, j] = (T[n, i, 0] * step[0, j] + T[n, i, 1] * step[1, j]
                                + T[n, i, 2] * step[2, j] + T[n, i, 3] * step[3, j])
        out[n, 3, 3] = 1.0
        _orthonormalise(out[n], step)
    return out


@numba.njit(cache=True, nogil=True, inline="always")
def _orthonormalise(T, room):  # type: ignore[no-untyped-def]
    """One Newton step R ← R (3 I − Rᵀ R) / 2: squares what rounding has added up."""
    for i in range(3):
        for j in range(3):
            square = T[0, i] * T[0, j] + T[1, i] * T[1, j] + T[2, i] * T[2, j]
            room[i, j] = (1.5 if i == j else 0.0) - 0.5 * square
    for i in range(3):
        x, y, z = T[i, 0], T[i, 1], T[i, 2]
        for j in range(3):
            T[i, j] = x * room[0, j] + y * room[1, j] + z * room[2, j]
