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
def point_row(T, ray, rho_a, uv_b, rho_b, camera):  # type: ignore[no-untyped-def]
    """One point of `point_terms`: r, its place (x, y, ρ) in b for `pose_rows`, and J_ρ.

    Compiled and on scalars, so that the solver's inner loops and `point_terms` are the same
    lines. `camera` is (fx, fy, cx, cy).
    """
    fx, fy, cx, cy = camera
    # p_b ρ_a = Rᵀ (ray − ρ t): scaled by ρ so that far points stay well conditioned.
    dx, dy, dz = ray[0] - rho_a * T[0, 3], ray[1] - rho_a * T[1, 3], ray[2] - rho_a * T[2, 3]
    w = T[0, 2] * dx + T[1, 2] * dy + T[2, 2] * dz
    if abs(w) < 1e-12:
        w = 1e-12
    x = (T[0, 0] * dx + T[1, 0] * dy + T[2, 0] * dz) / w
    y = (T[0, 1] * dx + T[1, 1] * dy + T[2, 1] * dz) / w
    rho = rho_a / w                                     # inverse depth in b
    r = (fx * x + cx - uv_b[0], fy * y + cy - uv_b[1], rho - rho_b)

    # ∂(p_b ρ_a)/∂ρ_a = −Rᵀ t
    tx = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    ty = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    tz = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    return r, (x, y, rho), (fx * (tx - x * tz) / w, fy * (ty - y * tz) / w, (1.0 - rho * tz) / w)


@numba.njit(cache=True, inline="always")
def pose_rows(place, camera):  # type: ignore[no-untyped-def]
    """J_pose of a point seen at (x, y, ρ): the rows of u, v and ρ as six numbers each."""
    x, y, rho = place
    fx, fy, _, _ = camera
    # ∂p_b/∂ξ = [p_b]× for ω and −I for v, since p_b = Exp(−ξ) T⁻¹ p_a.
    return ((fx * x * y, -fx * (1.0 + x * x), fx * y, -fx * rho, 0.0, fx * rho * x),
            (fy * (1.0 + y * y), -fy * x * y, -fy * x, 0.0, -fy * rho, fy * rho * y),
            (rho * y, -rho * x, 0.0, 0.0, 0.0, rho * rho))


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


@numba.njit(cache=True, nogil=True)
def _point_rows(T, group, rays, rho_a, uv_b, rho_b, camera):  # type: ignore[no-untyped-def]
    n = len(rho_a)
    r, J, j = np.empty((n, 3)), np.empty((n, 3, 6)), np.empty((n, 3))
    for i in range(n):
        found, place, own = point_row(T[group[i]], rays[i], rho_a[i], uv_b[i], rho_b[i], camera)
        rows = pose_rows(place, camera)
        for k in range(3):
            r[i, k], j[i, k] = found[k], own[k]
            for c in range(6):
                J[i, k, c] = rows[k][c]
    return r, J, j


@numba.njit(cache=True, inline="always")
def _line_through(a, b, pixel, line, J):  # type: ignore[no-untyped-def]
    """One row of `observed_line`: fills line (3,) and J (3, 4)."""
    line[0], line[1], line[2] = a[1] - b[1], b[0] - a[0], a[0] * b[1] - a[1] * b[0]   # a × b
    J[0, 0], J[0, 1], J[0, 2], J[0, 3] = 0.0, 1.0, 0.0, -1.0
    J[1, 0], J[1, 1], J[1, 2], J[1, 3] = -1.0, 0.0, 1.0, 0.0
    J[2, 0], J[2, 1], J[2, 2], J[2, 3] = b[1], -b[0], -a[1], a[0]
    third = 0.0 if pixel else line[2]
    norm = np.sqrt(line[0] * line[0] + line[1] * line[1] + third * third)
    if norm <= 1e-12:
        norm = np.nan
    line[0], line[1], line[2] = line[0] / norm, line[1] / norm, line[2] / norm
    for c in range(4):
        d_norm = line[0] * J[0, c] + line[1] * J[1, c] + third / norm * J[2, c]
        for i in range(3):
            J[i, c] = (J[i, c] - line[i] * d_norm) / norm


def observed_line(a_px: Array, b_px: Array, normalise: str = "pixel") -> tuple[Array, Array]:
    """The observed infinite image line l through a' and b' (eq. 2), and ∂l/∂(a', b').

    Args:
        a_px, b_px: (N, 2) endpoints a' = a + φ_a, b' = b + φ_b.
        normalise: "pixel" divides by hypot(l₀, l₁), so that l · m is a distance in px; "paper"
            divides by the 3-norm as printed.
    Returns:
        l (N, 3), J (N, 3, 4). Endpoints that coincide give NaN.
    """
    return _lines_through(np.asarray(a_px, np.float64), np.asarray(b_px, np.float64),
                          is_pixel(normalise))


def is_pixel(normalise: str) -> bool:
    """Whether image lines are normalised to distances in px ("pixel"), or as printed ("paper")."""
    if normalise not in ("pixel", "paper"):
        raise ValueError(f"normalise: wanted 'pixel' or 'paper', got {normalise!r}")
    return normalise == "pixel"


@numba.njit(cache=True, nogil=True)
def _lines_through(a, b, pixel):  # type: ignore[no-untyped-def]
    line, J = np.empty((len(a), 3)), np.empty((len(a), 3, 4))
    for n in range(len(a)):
        _line_through(a[n], b[n], pixel, line[n], J[n])
    return line, J


@numba.njit(cache=True, inline="always")
def line_row(T, rays, rho, ends_b, camera, pixel, r, J, j, J_flow,  # type: ignore[no-untyped-def]
             line, line_J):
    """One segment of `line_terms`: fills r (2,), J (2, 6), j (2,) and J_flow (2, 4).

    j is each row's derivative with respect to its own end's inverse depth. The last two are room
    for the observed line, (3,) and (3, 4).
    """
    _line_through(ends_b[0], ends_b[1], pixel, line, line_J)
    for end in range(2):
        uv, place, d_rho = point_row(T, rays[end], rho[end], (0.0, 0.0), 0.0, camera)
        rows = pose_rows(place, camera)
        r[end] = line[0] * uv[0] + line[1] * uv[1] + line[2]
        for c in range(6):
            J[end, c] = line[0] * rows[0][c] + line[1] * rows[1][c]
        j[end] = line[0] * d_rho[0] + line[1] * d_rho[1]
        for c in range(4):
            J_flow[end, c] = uv[0] * line_J[0, c] + uv[1] * line_J[1, c] + line_J[2, c]


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
    T = np.ascontiguousarray(np.asarray(T_a_b, dtype=np.float64).reshape(-1, 4, 4))
    group = np.zeros(len(rays_a), np.int64) if group is None else group
    return LineTerms(*_line_rows(T, group, rays_a, rho_a, endpoints_b, camera_tuple(camera),
                                 is_pixel(normalise)))


@numba.njit(cache=True, nogil=True)
def _line_rows(T, group, rays, rho, ends_b, camera, pixel):  # type: ignore[no-untyped-def]
    n = len(rays)
    r, J, J_flow = np.empty((n, 2)), np.empty((n, 2, 6)), np.empty((n, 2, 4))
    J_rho, j = np.zeros((n, 2, 2)), np.empty(2)
    line, line_J = np.empty(3), np.empty((3, 4))
    for i in range(n):
        line_row(T[group[i]], rays[i], rho[i], ends_b[i], camera, pixel, r[i], J[i], j, J_flow[i],
                 line, line_J)
        J_rho[i, 0, 0], J_rho[i, 1, 1] = j
    return r, J, J_rho, J_flow
