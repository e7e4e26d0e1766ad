"""Rigid motions SE(3) as (..., 4, 4) matrices, vectorised over leading axes.

Tangent vectors are [ω, v] (rotation first) and perturb on the right: T Exp(ξ).
"""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

_SMALL_ANGLE_SQUARED = 1e-8


def skew(v: Array) -> Array:
    """(..., 3) vectors to (..., 3, 3) cross-product matrices: skew(a) @ b = a × b."""
    v = np.asarray(v)
    out = np.zeros((*v.shape[:-1], 3, 3), dtype=v.dtype if v.dtype.kind == "f" else np.float64)
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def _rotation_series(w: Array) -> tuple[Array, Array, Array]:
    """sin θ/θ, (1−cos θ)/θ² and (θ−sin θ)/θ³, by their series near θ = 0; each (..., 1, 1)."""
    t2 = np.sum(w * w, axis=-1)[..., None, None]
    small = t2 < _SMALL_ANGLE_SQUARED
    t2_safe = np.where(small, 1.0, t2)
    t = np.sqrt(t2_safe)
    a = np.where(small, 1.0 - t2 / 6.0, np.sin(t) / t)
    b = np.where(small, 0.5 - t2 / 24.0, 2.0 * np.sin(0.5 * t) ** 2 / t2_safe)
    c = np.where(small, 1.0 / 6.0 - t2 / 120.0, (t - np.sin(t)) / (t2_safe * t))
    return a, b, c


def exp_so3(w: Array) -> Array:
    """Rotation vectors (..., 3) in radians to rotation matrices (..., 3, 3)."""
    w = np.asarray(w, dtype=np.float64)
    a, b, _ = _rotation_series(w)
    k = skew(w)
    return np.eye(3) + a * k + b * (k @ k)


def log_so3(R: Array) -> Array:
    """Rotation matrices (..., 3, 3) to rotation vectors (..., 3); exact near 0 and near π."""
    q = quaternion_from_rotation(R)
    v, w = q[..., :3], q[..., 3]
    sign = np.where(w < 0.0, -1.0, 1.0)
    v, w = v * sign[..., None], w * sign
    n = np.linalg.norm(v, axis=-1)
    safe = np.where(n > 1e-12, n, 1.0)
    scale = np.where(n > 1e-12, 2.0 * np.arctan2(n, w) / safe, 2.0 / np.where(w > 0, w, 1.0))
    return np.asarray(v * scale[..., None])


def exp(xi: Array) -> Array:
    """Tangent vectors (..., 6) = [ω rad, v m] to transforms (..., 4, 4)."""
    xi = np.asarray(xi, dtype=np.float64)
    w, v = xi[..., :3], xi[..., 3:]
    a, b, c = _rotation_series(w)
    k = skew(w)
    k2 = k @ k
    T = np.zeros((*xi.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + a * k + b * k2
    V = np.eye(3) + b * k + c * k2
    T[..., :3, 3] = (V @ v[..., None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def log(T: Array) -> Array:
    """Transforms (..., 4, 4) to tangent vectors (..., 6) = [ω rad, v m]."""
    T = np.asarray(T, dtype=np.float64)
    w = log_so3(T[..., :3, :3])
    _, b, c = _rotation_series(w)
    k = skew(w)
    V = np.eye(3) + b * k + c * (k @ k)
    v = np.linalg.solve(V, T[..., :3, 3][..., None])[..., 0]
    return np.concatenate([w, v], axis=-1)


def inverse(T: Array) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3][..., None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def adjoint(T: Array) -> Array:
    """(..., 6, 6) with T Exp(ξ) T⁻¹ = Exp(Ad_T ξ), for ξ = [ω, v]."""
    T = np.asarray(T, dtype=np.float64)
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = R
    out[..., 3:, 3:] = R
    out[..., 3:, :3] = skew(t) @ R
    return out


def transform_points(T_b_a: Array, points_a: Array) -> Array:
    """Move points (..., N, 3) from frame a to frame b."""
    T = np.asarray(T_b_a)
    return points_a @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def from_rotation_translation(R: Array, t: Array) -> Array:
    """Transforms (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    R, t = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def rotation_angle(R: Array) -> Array:
    """Angle (...) in radians of rotations (..., 3, 3), exact near zero: 2 asin(‖R−I‖_F / 2√2)."""
    R = np.asarray(R, dtype=np.float64)
    gap = np.linalg.norm(R - np.eye(3), axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.minimum(1.0, gap / (2.0 * np.sqrt(2.0)))))


def orthonormalised(T: Array) -> Array:
    """The transforms (..., 4, 4) with their rotations projected back on SO(3)."""
    T = np.array(T, dtype=np.float64)
    U, _, Vt = np.linalg.svd(T[..., :3, :3])
    sign = np.linalg.det(U @ Vt)
    U[..., :, 2] *= sign[..., None]
    T[..., :3, :3] = U @ Vt
    return T


def rotation_from_quaternion(quat_xyzw: Array) -> Array:
    """Quaternions (..., 4), order x y z w, of any length > 0, to rotations (..., 3, 3)."""
    q = np.asarray(quat_xyzw, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    v, w = q[..., :3], q[..., 3][..., None, None]
    k = skew(v)
    return np.eye(3) + 2.0 * w * k + 2.0 * (k @ k)


def quaternion_from_rotation(R: Array) -> Array:
    """Rotations (..., 3, 3) to unit quaternions (..., 4), order x y z w, w ≥ 0."""
    R = np.asarray(R, dtype=np.float64)
    m = [[R[..., i, j] for j in range(3)] for i in range(3)]
    # The four rows of 4 q qᵀ: the one with the largest diagonal element is well conditioned.
    xx = 1 + m[0][0] - m[1][1] - m[2][2]
    yy = 1 - m[0][0] + m[1][1] - m[2][2]
    zz = 1 - m[0][0] - m[1][1] + m[2][2]
    ww = 1 + m[0][0] + m[1][1] + m[2][2]
    xy, xz, yz = m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]
    xw, yw, zw = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    rows = np.stack([np.stack([xx, xy, xz, xw], -1), np.stack([xy, yy, yz, yw], -1),
                     np.stack([xz, yz, zz, zw], -1), np.stack([xw, yw, zw, ww], -1)], -2)
    best = np.argmax(np.stack([xx, yy, zz, ww], -1), axis=-1)
    q = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))
