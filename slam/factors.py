"""The back-end's equations of points and poses, each with its analytic Jacobian.

Those of lines stand in slam.line_factors and slam.line_sightings. Poses T_body_camera are
perturbed on the right, T Exp(ξ), ξ = [ω, v]. A body is the static world or a rigid object: in the
object-centric formulation both are measured by the same equations.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole
from slam.geometry.se3_jacobian import right_jacobian_inverse
from slam.geometry.se3_rows import between_row, log_row, right_jacobian_row
from slam.residuals import camera_tuple

MIN_DEPTH_M = 1e-3       # a point nearer to the camera's plane, or behind it, has no image


class LandmarkTerms(NamedTuple):
    """Residuals of N measured points; NaN where a point has no image."""

    r: Array           # (N, 3)
    J_pose: Array      # (N, 3, 6)
    J_point: Array     # (N, 3, 3)


class PairTerms(NamedTuple):
    """Residuals that tie two variables of the same kind."""

    r: Array           # (N, 6)
    J_first: Array     # (N, 6, 6)
    J_second: Array    # (N, 6, 6)


class PointMotionTerms(NamedTuple):
    r: Array           # (N, 3) m
    J_H: Array         # (N, 3, 6)
    J_before: Array    # (N, 3, 3) with respect to M_{k-1}
    J_now: Array       # (N, 3, 3) with respect to M_k


@numba.njit(cache=True, inline="always")
def landmark_row(T, xyz, uv, rho, camera, r, J, V):  # type: ignore[no-untyped-def]
    """One point of `landmark_terms`: fills r (3,), J (3, 6), V (3, 3); False if it has no image."""
    fx, fy, cx, cy = camera
    dx, dy, dz = xyz[0] - T[0, 3], xyz[1] - T[1, 3], xyz[2] - T[2, 3]
    x = T[0, 0] * dx + T[1, 0] * dy + T[2, 0] * dz
    y = T[0, 1] * dx + T[1, 1] * dy + T[2, 1] * dz
    z = T[0, 2] * dx + T[1, 2] * dy + T[2, 2] * dz
    if not z > MIN_DEPTH_M:
        return False
    inverse = 1.0 / z
    xn, yn = x * inverse, y * inverse
    r[0] = fx * xn + cx - uv[0]
    r[1] = fy * yn + cy - uv[1]
    r[2] = inverse - rho
    J[0, 0], J[0, 1], J[0, 2] = fx * xn * yn, -fx * (1.0 + xn * xn), fx * yn
    J[0, 3], J[0, 4], J[0, 5] = -fx * inverse, 0.0, fx * inverse * xn
    J[1, 0], J[1, 1], J[1, 2] = fy * (1.0 + yn * yn), -fy * xn * yn, -fy * xn
    J[1, 3], J[1, 4], J[1, 5] = 0.0, -fy * inverse, fy * inverse * yn
    J[2, 0], J[2, 1], J[2, 2] = inverse * yn, -inverse * xn, 0.0
    J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, inverse * inverse
    for c in range(3):
        V[0, c] = fx * inverse * (T[c, 0] - xn * T[c, 2])
        V[1, c] = fy * inverse * (T[c, 1] - yn * T[c, 2])
        V[2, c] = -inverse * inverse * T[c, 2]
    return True


@numba.njit(cache=True)
def _landmark_rows(T, xyz, uv, rho, camera):  # type: ignore[no-untyped-def]
    n = len(xyz)
    r, J, V = np.empty((n, 3)), np.zeros((n, 3, 6)), np.zeros((n, 3, 3))
    for i in range(n):
        if not landmark_row(T[i], xyz[i], uv[i], rho[i], camera, r[i], J[i], V[i]):
            r[i] = np.nan
    return r, J, V


def landmark_terms(T_body_camera: Array, xyz_body: Array, uv: Array, rho: Array,
                   camera: Pinhole) -> LandmarkTerms:
    """3D point measurement as the sensor makes it: pixel and inverse depth.

    Rows (u, v in px; 1/z in 1/m), predicted minus observed. In these units noise is nearly
    Gaussian and even over all depths, which `landmark_terms_metric` is not.

    Args:
        T_body_camera: (N, 4, 4) pose of the camera that sees each point.
        xyz_body: (N, 3) m.
        uv: (N, 2) observed pixels.
        rho: (N,) observed inverse depths, 1/m.
    """
    return LandmarkTerms(*_landmark_rows(
        np.ascontiguousarray(T_body_camera, dtype=np.float64),
        np.ascontiguousarray(xyz_body, dtype=np.float64), np.asarray(uv, dtype=np.float64),
        np.asarray(rho, dtype=np.float64), camera_tuple(camera)))


def landmark_terms_metric(T_body_camera: Array, xyz_body: Array, xyz_camera: Array
                          ) -> LandmarkTerms:
    """3D point measurement in the paper's form: X⁻¹ M − z, in metres."""
    T = np.asarray(T_body_camera, dtype=np.float64)
    Rt = np.swapaxes(T[:, :3, :3], 1, 2)
    p = np.einsum("nij,nj->ni", Rt, xyz_body - T[:, :3, 3])
    J = np.zeros((len(p), 3, 6))
    J[:, :, :3] = se3.skew(p)
    J[:, :, 3:] = -np.eye(3)
    return LandmarkTerms(p - xyz_camera, J, Rt)


def back_projected_covariance(uv: Array, rho: Array, covariance: Array, rho_sigma: Array,
                              camera: Pinhole) -> Array:
    """(N, 3, 3) m² of points [x, y, 1]/ρ in the camera, from the noise of pixel and depth.

    Args:
        uv, rho: (N, 2) px and (N,) 1/m, > 0; covariance: (N, 2, 2) px²; rho_sigma: (N,) 1/m.
    """
    fx, fy, cx, cy = camera_tuple(camera)
    scale = 1.0 / rho
    J = np.zeros((len(rho), 3, 3))
    J[:, 0, 0], J[:, 1, 1] = scale / fx, scale / fy
    J[:, :, 2] = -(scale**2)[:, None] * np.stack(
        [(uv[:, 0] - cx) / fx, (uv[:, 1] - cy) / fy, np.ones(len(rho))], axis=1)
    measured = np.zeros((len(rho), 3, 3))
    measured[:, :2, :2], measured[:, 2, 2] = covariance, rho_sigma**2
    return np.asarray(J @ measured @ np.swapaxes(J, 1, 2))


@numba.njit(cache=True)
def _odometry_rows(T_first, T_second, T_measured):  # type: ignore[no-untyped-def]
    n = len(T_first)
    r, J_first, J_second = np.empty((n, 6)), np.empty((n, 6, 6)), np.empty((n, 6, 6))
    relative, error, J = np.empty((4, 4)), np.empty((4, 4)), np.empty((6, 6))
    for i in range(n):
        between_row(T_first[i], T_second[i], relative)
        between_row(T_measured[i], relative, error)
        log_row(error, r[i])
        right_jacobian_row(r[i], J)
        J_second[i] = np.linalg.inv(J)
        _minus_times_adjoint_of_inverse(J_second[i], relative, J_first[i])
    return r, J_first, J_second


@numba.njit(cache=True)
def _minus_times_adjoint_of_inverse(J, T, out):  # type: ignore[no-untyped-def]
    """Fill out (6, 6) with −J Ad(T⁻¹), Ad(T⁻¹) = [[Rᵀ, 0], [−Rᵀ [t]×, Rᵀ]]."""
    ad = np.zeros((6, 6))
    t0, t1, t2 = T[0, 3], T[1, 3], T[2, 3]
    for i in range(3):
        a, b, c = T[0, i], T[1, i], T[2, i]
        ad[i, 0], ad[i, 1], ad[i, 2] = a, b, c
        ad[i + 3, 3], ad[i + 3, 4], ad[i + 3, 5] = a, b, c
        ad[i + 3, 0], ad[i + 3, 1], ad[i + 3, 2] = (c * t1 - b * t2, a * t2 - c * t0,
                                                    b * t0 - a * t1)
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += J[i, k] * ad[k, j]
            out[i, j] = -total


def odometry_terms(T_first: Array, T_second: Array, T_measured: Array) -> PairTerms:
    """Log(Z⁻¹ T₁⁻¹ T₂) of N measured relative poses Z (N, 4, 4), [rad, m]."""
    return PairTerms(*_odometry_rows(*(np.ascontiguousarray(T, dtype=np.float64)
                                       for T in (T_first, T_second, T_measured))))


def point_motion_terms(H: Array, M_before: Array, M_now: Array) -> PointMotionTerms:
    """Motion of points: M_k − H_k M_{k−1}, for N points (N, 3) and motions (N, 4, 4)."""
    R = H[:, :3, :3]
    moved = np.einsum("nij,nj->ni", R, M_before) + H[:, :3, 3]
    J_H = np.concatenate([R @ se3.skew(M_before), -R], axis=2)
    return PointMotionTerms(M_now - moved, J_H, -R, np.broadcast_to(np.eye(3), R.shape))


def smooth_motion_terms(H_before: Array, H_now: Array, centroid_before: Array,
                        centroid_now: Array) -> PairTerms:
    """Change of an object's motion, both motions taken at the object's own centroid.

    A = D(c)⁻¹ H D(c) with D(c) the translation to c: its translation is how the centroid moves,
    wherever the world's origin lies. Residual: Log(A_{k−1}⁻¹ A_k), [rad, m].

    Args:
        H_before, H_now: (N, 4, 4) motions in the world, of two successive steps.
        centroid_before, centroid_now: (N, 3) where each motion starts; held fixed.
    """
    D_before, D_now = _translation(centroid_before), _translation(centroid_now)
    A_before = se3.inverse(D_before) @ H_before @ D_before
    A_now = se3.inverse(D_now) @ H_now @ D_now
    change = se3.inverse(A_before) @ A_now
    r = se3.log(change)
    J = right_jacobian_inverse(r)
    return PairTerms(r, -J @ se3.adjoint(se3.inverse(change) @ se3.inverse(D_before)),
                     J @ se3.adjoint(se3.inverse(D_now)))


def _translation(t: Array) -> Array:
    return np.asarray(se3.from_rotation_translation(np.eye(3), t))
