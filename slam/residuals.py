"""Every equation that tracking optimises, with its analytic Jacobian.

Frames: a is the previous camera, b the current one. The variable is T_a_b, the pose of camera b
in a, perturbed on the right: T_a_b Exp(ξ), ξ = [ω, v]. For the static world this is the camera's
own motion; for a rigid object it is the camera's motion as the object sees it, the inverse of
eq. (4)'s G carried to camera a, so that equations (2) and (4) are one function.

Residuals are "predicted minus observed" where a sign is free; equation numbers are SDPL-SLAM's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole


class PointTerms(NamedTuple):
    """Rows (u, v in px; inverse depth in 1/m) of N points."""

    r: Array           # (N, 3) predicted minus observed
    J_pose: Array      # (N, 3, 6) with respect to ξ
    J_rho: Array       # (N, 3) with respect to the inverse depth in camera a


class LineTerms(NamedTuple):
    """Distances in px of both projected endpoints of N segments from the observed line."""

    r: Array           # (N, 2)
    J_pose: Array      # (N, 2, 6) with respect to ξ
    J_rho: Array       # (N, 2, 2) with respect to the inverse depths of A and B in camera a
    J_flow: Array      # (N, 2, 4) with respect to (φ_a, φ_b)


def feature_last(n: int, *shape: int) -> Array:
    """An empty (n, *shape) array whose memory runs along n, so that columns are contiguous."""
    axes = (len(shape), *range(len(shape)))
    return np.empty((*shape, n)).transpose(axes)


def point_terms(T_a_b: Array, rays_a: Array, rho_a: Array, uv_b: Array, rho_b: Array,
                camera: Pinhole) -> PointTerms:
    """Reprojection and inverse-depth error of points: eq. (2) e_p, and the depth seen in b.

    The point is ray / ρ in camera a. Row 3 compares 1/z in camera b with the inverse depth
    measured there: the paper leaves the second frame's depth unused.

    Args:
        T_a_b: (N, 4, 4) or (4, 4) pose of camera b in a.
        rays_a: (N, 3) directions with z = 1 in camera a.
        rho_a: (N,) inverse depths in a, 1/m.
        uv_b: (N, 2) observed pixels in b, m + φ.
        rho_b: (N,) inverse depths measured in b, 1/m (any value where unknown).
    """
    T = np.asarray(T_a_b)
    # p_b ρ_a = Rᵀ (ray − ρ t): scaled by ρ so that far points stay well conditioned.
    shifted = rays_a - rho_a[:, None] * T[..., :3, 3]
    R = T[..., :3, :3]
    x, y, w = (shifted[:, 0] * R[..., 0, i] + shifted[:, 1] * R[..., 1, i]
               + shifted[:, 2] * R[..., 2, i] for i in range(3))
    inv_w = 1.0 / w
    xn, yn = x * inv_w, y * inv_w
    rho = rho_a * inv_w                                 # inverse depth in b
    fx, fy = camera.fx, camera.fy

    r = feature_last(len(rho_a), 3)
    r[:, 0] = fx * xn + camera.cx - uv_b[:, 0]
    r[:, 1] = fy * yn + camera.cy - uv_b[:, 1]
    r[:, 2] = rho - rho_b

    # ∂p_b/∂ξ = [p_b]× for ω and −I for v, since p_b = Exp(−ξ) T⁻¹ p_a.
    J = feature_last(len(rho_a), 3, 6)
    J[:, 0, 0] = fx * xn * yn
    J[:, 0, 1] = -fx * (1.0 + xn * xn)
    J[:, 0, 2] = fx * yn
    J[:, 0, 3] = -fx * rho
    J[:, 0, 4] = 0.0
    J[:, 0, 5] = fx * rho * xn
    J[:, 1, 0] = fy * (1.0 + yn * yn)
    J[:, 1, 1] = -fy * xn * yn
    J[:, 1, 2] = -fy * xn
    J[:, 1, 3] = 0.0
    J[:, 1, 4] = -fy * rho
    J[:, 1, 5] = fy * rho * yn
    J[:, 2, 0] = rho * yn
    J[:, 2, 1] = -rho * xn
    J[:, 2, 2] = 0.0
    J[:, 2, 3] = 0.0
    J[:, 2, 4] = 0.0
    J[:, 2, 5] = rho * rho

    # ∂scaled/∂ρ_a = −Rᵀ t = t_b_a
    t_b_a = -(np.matmul(T[..., None, :3, 3], R)[..., 0, :])
    tx, ty, tz = t_b_a[..., 0], t_b_a[..., 1], t_b_a[..., 2]
    J_rho = feature_last(len(rho_a), 3)
    J_rho[:, 0] = fx * inv_w * (tx - xn * tz)
    J_rho[:, 1] = fy * inv_w * (ty - yn * tz)
    J_rho[:, 2] = inv_w * (1.0 - rho * tz)
    return PointTerms(r, J, J_rho)


def observed_line(a_px: Array, b_px: Array, normalise: str = "pixel") -> tuple[Array, Array]:
    """The observed infinite image line l through a' and b' (eq. 2), and ∂l/∂(a', b').

    Args:
        a_px, b_px: (N, 2) endpoints a' = a + φ_a, b' = b + φ_b.
        normalise: "pixel" divides by hypot(l₀, l₁), so that l · m is a distance in px; "paper"
            divides by the 3-norm as printed.
    Returns:
        l (N, 3), J (N, 3, 4). Endpoints that coincide give NaN.
    """
    n = len(a_px)
    a = np.concatenate([a_px, np.ones((n, 1))], axis=1)
    b = np.concatenate([b_px, np.ones((n, 1))], axis=1)
    cross = np.cross(a, b)
    d_cross = np.concatenate([-se3.skew(b)[:, :, :2], se3.skew(a)[:, :, :2]], axis=2)
    if normalise == "pixel":
        part = cross * np.array([1.0, 1.0, 0.0])
    elif normalise == "paper":
        part = cross
    else:
        raise ValueError(f"normalise: wanted 'pixel' or 'paper', got {normalise!r}")
    norm = np.linalg.norm(part, axis=1)
    norm = np.where(norm > 1e-12, norm, np.nan)
    line = cross / norm[:, None]
    d_norm = np.einsum("ni,nij->nj", part, d_cross) / norm[:, None]
    J = (d_cross - line[:, :, None] * d_norm[:, None, :]) / norm[:, None, None]
    return line, J


def line_terms(T_a_b: Array, rays_a: Array, rho_a: Array, endpoints_b: Array,
               camera: Pinhole, normalise: str = "pixel") -> LineTerms:
    """Line reprojection error e_l of eq. (2), for the static world and objects (eq. 4) alike.

    Both rows are full: l · π(A) and l · π(B), and each flow moves the whole observed line.

    Args:
        T_a_b: (N, 4, 4) or (4, 4).
        rays_a: (N, 2, 3) directions with z = 1 of A and B in camera a.
        rho_a: (N, 2) their inverse depths, 1/m.
        endpoints_b: (N, 2, 2) observed endpoints a', b' in camera b, px.
    """
    n = len(rays_a)
    T = np.asarray(T_a_b)
    T_both = T if T.ndim == 2 else np.repeat(T, 2, axis=0)
    terms = point_terms(T_both, rays_a.reshape(-1, 3), rho_a.reshape(-1),
                        np.zeros((2 * n, 2)), np.zeros(2 * n), camera)
    uv = terms.r[:, :2].reshape(n, 2, 2)
    line, d_line = observed_line(endpoints_b[:, 0], endpoints_b[:, 1], normalise)
    normal = line[:, None, :2]
    r = np.sum(normal * uv, axis=2) + line[:, None, 2]
    J_uv = terms.J_pose[:, :2].reshape(n, 2, 2, 6)
    J_pose = np.einsum("ni,npij->npj", line[:, :2], J_uv)
    J_own = np.einsum("ni,npi->np", line[:, :2], terms.J_rho[:, :2].reshape(n, 2, 2))
    J_rho = np.zeros((n, 2, 2))
    J_rho[:, 0, 0], J_rho[:, 1, 1] = J_own[:, 0], J_own[:, 1]
    homogeneous = np.concatenate([uv, np.ones((n, 2, 1))], axis=2)
    return LineTerms(r, J_pose, J_rho, homogeneous @ d_line)
