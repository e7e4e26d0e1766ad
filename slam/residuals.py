"""Every equation that tracking optimises, with its analytic Jacobian.

Frames: a is the previous camera, b the current one. The variable is T_a_b, the pose of camera b
in a, perturbed on the right: T_a_b Exp(ξ), ξ = [ω, v]. For the static world this is the camera's
own motion; for a rigid object it is the camera's motion as the object sees it, the inverse of
eq. (4)'s G carried to camera a, so that equations (2) and (4) are one function.

Residuals are "predicted minus observed" where a sign is free; equation numbers are SDPL-SLAM's.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
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


@numba.njit(cache=True, inline="always")
def point_row(T, ray, rho_a, uv_b, rho_b, camera, r, J, j):  # type: ignore[no-untyped-def]
    """One point of `point_terms`: fills r (3,), J (3, 6) and j (3,).

    Compiled, so that the solver's inner loop and `point_terms` are the same lines. `camera` is
    (fx, fy, cx, cy).
    """
    fx, fy, cx, cy = camera
    # p_b ρ_a = Rᵀ (ray − ρ t): scaled by ρ so that far points stay well conditioned.
    dx, dy, dz = ray[0] - rho_a * T[0, 3], ray[1] - rho_a * T[1, 3], ray[2] - rho_a * T[2, 3]
    x = T[0, 0] * dx + T[1, 0] * dy + T[2, 0] * dz
    y = T[0, 1] * dx + T[1, 1] * dy + T[2, 1] * dz
    w = T[0, 2] * dx + T[1, 2] * dy + T[2, 2] * dz
    if abs(w) < 1e-12:
        w = 1e-12
    xn, yn, rho = x / w, y / w, rho_a / w               # rho: inverse depth in b
    r[0] = fx * xn + cx - uv_b[0]
    r[1] = fy * yn + cy - uv_b[1]
    r[2] = rho - rho_b

    # ∂p_b/∂ξ = [p_b]× for ω and −I for v, since p_b = Exp(−ξ) T⁻¹ p_a.
    J[0, 0], J[0, 1], J[0, 2] = fx * xn * yn, -fx * (1.0 + xn * xn), fx * yn
    J[0, 3], J[0, 4], J[0, 5] = -fx * rho, 0.0, fx * rho * xn
    J[1, 0], J[1, 1], J[1, 2] = fy * (1.0 + yn * yn), -fy * xn * yn, -fy * xn
    J[1, 3], J[1, 4], J[1, 5] = 0.0, -fy * rho, fy * rho * yn
    J[2, 0], J[2, 1], J[2, 2] = rho * yn, -rho * xn, 0.0
    J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, rho * rho

    # ∂(p_b ρ_a)/∂ρ_a = −Rᵀ t
    tx = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    ty = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    tz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    j[0] = fx * (tx - xn * tz) / w
    j[1] = fy * (ty - yn * tz) / w
    j[2] = (1.0 - rho * tz) / w


def camera_tuple(camera: Pinhole) -> tuple[float, float, float, float]:
    """The camera as compiled functions take it."""
    return float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)


def point_terms(T_a_b: Array, rays_a: Array, rho_a: Array, uv_b: Array, rho_b: Array,
                camera: Pinhole, group: Array | None = None) -> PointTerms:
    """Reprojection and inverse-depth error of points: eq. (2) e_p, and the depth seen in b.

    The point is ray / ρ in camera a. Row 3 compares 1/z in camera b with the inverse depth
    measured there: the paper leaves the second frame's depth unused.

    Args:
        T_a_b: (4, 4) pose of camera b in a, or (G, 4, 4) one for each group.
        rays_a: (N, 3) directions with z = 1 in camera a.
        rho_a: (N,) inverse depths in a, 1/m.
        uv_b: (N, 2) observed pixels in b, m + φ.
        rho_b: (N,) inverse depths measured in b, 1/m (any value where unknown).
        group: (N,) which pose each point moves with; None: the only one.
    """
    T = np.ascontiguousarray(np.asarray(T_a_b, dtype=np.float64).reshape(-1, 4, 4))
    group = np.zeros(len(rho_a), np.int64) if group is None else group
    return PointTerms(*_point_rows(T, group, rays_a, rho_a, uv_b, rho_b, camera_tuple(camera)))


@numba.njit(cache=True)
def _point_rows(T, group, rays, rho_a, uv_b, rho_b, camera):  # type: ignore[no-untyped-def]
    n = len(rho_a)
    r, J, j = np.empty((n, 3)), np.empty((n, 3, 6)), np.empty((n, 3))
    for i in range(n):
        point_row(T[group[i]], rays[i], rho_a[i], uv_b[i], rho_b[i], camera, r[i], J[i], j[i])
    return r, J, j


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
               camera: Pinhole, normalise: str = "pixel",
               group: Array | None = None) -> LineTerms:
    """Line reprojection error e_l of eq. (2), for the static world and objects (eq. 4) alike.

    Both rows are full: l · π(A) and l · π(B), and each flow moves the whole observed line.

    Args:
        T_a_b: (4, 4), or (G, 4, 4) one for each group.
        rays_a: (N, 2, 3) directions with z = 1 of A and B in camera a.
        rho_a: (N, 2) their inverse depths, 1/m.
        endpoints_b: (N, 2, 2) observed endpoints a', b' in camera b, px.
        group: (N,) which pose each segment moves with; None: the only one.
    """
    n = len(rays_a)
    terms = point_terms(T_a_b, rays_a.reshape(-1, 3), rho_a.reshape(-1), np.zeros((2 * n, 2)),
                        np.zeros(2 * n), camera, None if group is None else np.repeat(group, 2))
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
