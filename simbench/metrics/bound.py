"""The Cramér–Rao bound of a rigid motion between two frames: what no unbiased estimate undercuts.

Computed from the true geometry alone, with its own projection and numerical derivatives, so that
it shares nothing with the estimators that are held against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.types import Intrinsics

_STEP = 1e-6        # of numerical derivatives: rad, m, and relative to the inverse depth


@dataclass(frozen=True, slots=True)
class TrueCorrespondences:
    """Points of one rigid body seen in frames a and b, and the noise with which they are seen.

    Each gives its pixel in b and its inverse depth in both frames; its pixel in a is exact, since
    it is where the flow is read.
    """

    uv_a: Array          # (N, 2) px
    rho_a: Array         # (N,) 1/m, true
    sigma_px: Array      # (N,) of the flow, each axis
    sigma_rho_a: Array   # (N,) 1/m
    sigma_rho_b: Array   # (N,) 1/m; inf where frame b has no depth

    def __post_init__(self) -> None:
        freeze_fields(self, uv_a=("N", 2), rho_a=("N",), sigma_px=("N",), sigma_rho_a=("N",),
                      sigma_rho_b=("N",))


def motion_information(T_a_b: Array, seen: TrueCorrespondences, camera: Intrinsics) -> Array:
    """Fisher information (6, 6) of ξ in T_a_b Exp(ξ), ξ = [ω, v], true depths being unknown.

    The measurements u, v, ρ_b and ρ_a are Gaussian about what the geometry gives; each point's
    inverse depth is eliminated by the Schur complement.

    Args:
        T_a_b: (4, 4) true pose of camera b in a as the rigid body sees it: the camera's own motion
            for the static world, X⁻¹ H⁻¹ X' for an object that moves by H.
    """
    T, rho = np.asarray(T_a_b, dtype=np.float64), np.asarray(seen.rho_a)
    columns = []
    for axis in range(6):
        xi = np.zeros(6)
        xi[axis] = _STEP
        ahead, behind = (_seen_in_b(T @ se3.exp(sign * xi), seen.uv_a, rho, camera)
                         for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * _STEP))
    J = np.stack(columns, axis=-1)                                     # (N, 3, 6)
    h = _STEP * np.maximum(rho, 1e-3)
    j = (_seen_in_b(T, seen.uv_a, rho + h, camera)
         - _seen_in_b(T, seen.uv_a, rho - h, camera)) / (2.0 * h)[:, None]   # (N, 3)
    weight = np.stack([seen.sigma_px, seen.sigma_px, seen.sigma_rho_b], axis=-1) ** -2.0
    of_rho = np.sum(weight * j**2, axis=1) + np.asarray(seen.sigma_rho_a) ** -2.0
    shared = np.einsum("ni,nij,ni->nj", weight, J, j)
    return np.asarray(np.einsum("ni,nij,nik->jk", weight, J, J)
                      - np.einsum("nj,nk,n->jk", shared, shared, 1.0 / of_rho))


def object_motion_covariance(T_object_camera_b: Array, of_camera: Array, of_object: Array) -> Array:
    """Covariance (6, 6) of an object's body-frame motion L⁻¹ H L Exp(ξ), from both bounds.

    The object moves against the static world by T_cam T_obj⁻¹ (in camera a), so that its error is
    that of both poses, carried from camera b to the object's frame.

    Args:
        T_object_camera_b: (4, 4) pose of camera b in the object's frame in frame b.
        of_camera, of_object: (6, 6) information of T_a_b for the static world and for the object.
    """
    A = se3.adjoint(T_object_camera_b)
    return np.asarray(A @ (np.linalg.inv(of_camera) + np.linalg.inv(of_object)) @ A.T)


def _seen_in_b(T_a_b: Array, uv_a: Array, rho_a: Array, camera: Intrinsics) -> Array:
    """(N, 3) pixel and inverse depth in b of points of a."""
    ray = np.stack([(uv_a[:, 0] - camera.cx) / camera.fx, (uv_a[:, 1] - camera.cy) / camera.fy,
                    np.ones(len(uv_a))], axis=-1)
    p = (ray / rho_a[:, None] - T_a_b[:3, 3]) @ T_a_b[:3, :3]
    return np.stack([camera.fx * p[:, 0] / p[:, 2] + camera.cx,
                     camera.fy * p[:, 1] / p[:, 2] + camera.cy, 1.0 / p[:, 2]], axis=-1)
