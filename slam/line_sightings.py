"""A line seen in an image: its distance in px from both observed ends, and inverse depth there.

Equation (5) as a camera with depth measures it: the ends that are observed slide along the line,
so each gives one distance across it, in px, and the inverse depth of the line at that place. In
these units noise is even over all depths (slam.factors.landmark_terms does the same for points).
Equation (5) as printed, in metres, stands beside it for compiled loops (`line_distance_row`);
slam.line_factors has it in arrays, and well conditioned.

A line is stored as ten numbers: the rotation of its orthonormal representation, row by row, and
the angle (slam.geometry.line.OrthonormalLines).
"""

from __future__ import annotations

from itertools import pairwise

import numba
import numpy as np

from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole
from slam.geometry.line import OrthonormalLines, feet_of_origin, plucker_from_orthonormal
from slam.geometry.se3_rows import exp_so3_row, log_so3_row
from slam.line_factors import ZERO_M, LineTerms
from slam.residuals import camera_tuple

_MIN_SINE = 1e-9       # as in slam.geometry.line: at infinity is 1e9 m away
_THROUGH_CAMERA_M = 1e-6   # a line this near to the camera's centre is seen as a point
_END_ON = 1e-6         # sine, below which an image line or its depth is not defined


def packed(lines: OrthonormalLines) -> Array:
    """(N, 10) of N lines."""
    return np.concatenate([lines.rotation.reshape(-1, 9), lines.angle_rad[:, None]], axis=1)


def unpacked(lines: Array) -> OrthonormalLines:
    """The lines of (N, 10) numbers."""
    return OrthonormalLines(lines[:, :9].reshape(-1, 3, 3), lines[:, 9])


@numba.njit(cache=True)
def line_sighting_row(T, line, ends, rho, camera, r, J, V, by):  # type: ignore[no-untyped-def]
    """One line of `line_sighting_terms`: fills r (4,), J (4, 6), V (4, 4); False if unseen.

    Args:
        by: (6, 11) room: [N, U] in the camera, and their derivatives by ξ (6) and δ (4).
    """
    fx, fy, cx, cy = camera
    along_u, along_v = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    length = np.hypot(along_u, along_v)
    _in_camera(T, line, by)
    nx, ny, nz = by[0, 0], by[1, 0], by[2, 0]
    far = np.sqrt(nx * nx + ny * ny + nz * nz)
    px, py = nx / fx, ny / fy
    size = np.sqrt(px * px + py * py)
    if not (length > 1e-3 and far > _THROUGH_CAMERA_M and size * fx > _END_ON * far):
        return False
    # Across the observed segment, as a direction in the camera.
    ex, ey = -along_v / (length * fx), along_u / (length * fy)
    for end in range(2):
        x, y = (ends[end, 0] - cx) / fx, (ends[end, 1] - cy) / fy
        d = (nx * x + ny * y + nz) / size
        # The plane through the pixel's ray, across the segment, cuts the line at (m × N)/(m · U).
        mx, my, mz = -ey, ex, x * ey - y * ex
        over = mx * ny - my * nx
        if not abs(over) * fx > _END_ON * far:
            return False
        seen = (mx * by[3, 0] + my * by[4, 0] + mz * by[5, 0]) / over
        if not seen > 0.0:
            return False
        r[end], r[2 + end] = d, seen - rho[end]
        d0, d1 = (x - d * px / (size * fx)) / size, (y - d * py / (size * fy)) / size
        d2 = 1.0 / size
        s0, s1 = seen * my / over, -seen * mx / over
        m0, m1, m2 = mx / over, my / over, mz / over
        for c in range(10):
            a, b = by[0, 1 + c], by[1, 1 + c]
            by_d = d0 * a + d1 * b + d2 * by[2, 1 + c]
            by_s = s0 * a + s1 * b + m0 * by[3, 1 + c] + m1 * by[4, 1 + c] + m2 * by[5, 1 + c]
            if c < 6:
                J[end, c], J[2 + end, c] = by_d, by_s
            else:
                V[end, c - 6], V[2 + end, c - 6] = by_d, by_s
    return True


@numba.njit(cache=True)
def line_distance_row(T, line, ends, r, J, V, by):  # type: ignore[no-untyped-def]
    """One line of eq. (5) as printed: fills r (2,), J (2, 6), V (2, 4).

    r = [‖A × U − N‖, ‖B × U − N‖] in metres. A length below `ZERO_M` has the derivative 0, as in
    slam.line_factors.line_measurement_paper.

    Args:
        ends: (2, 3) observed A and B in the camera, m.
        by: (6, 11) room, as that of `line_sighting_row`.
    """
    _in_camera(T, line, by)
    for end in range(2):
        x, y, z = ends[end, 0], ends[end, 1], ends[end, 2]
        e0 = y * by[5, 0] - z * by[4, 0] - by[0, 0]
        e1 = z * by[3, 0] - x * by[5, 0] - by[1, 0]
        e2 = x * by[4, 0] - y * by[3, 0] - by[2, 0]
        length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        over = 1.0 / length if length > ZERO_M else 0.0
        r[end] = length
        for c in range(10):
            u0, u1, u2 = by[3, 1 + c], by[4, 1 + c], by[5, 1 + c]
            d = over * (e0 * (y * u2 - z * u1 - by[0, 1 + c])
                        + e1 * (z * u0 - x * u2 - by[1, 1 + c])
                        + e2 * (x * u1 - y * u0 - by[2, 1 + c]))
            if c < 6:
                J[end, c] = d
            else:
                V[end, c - 6] = d


def ends_in_metres(ends_px: Array, covariance: Array, rho: Array, rho_sigma: Array,
                   camera: Pinhole) -> tuple[Array, Array]:
    """Observed ends (M, 2, 3) in the camera, m, and how far off (M, 2) each may be from its line.

    That is the standard deviation of the length, for lines across the view; inf: no depth.

    Args:
        ends_px: (M, 2, 2); covariance: (M, 2, 2) px² of both ends' offsets across the line.
        rho, rho_sigma: (M, 2) inverse depths there, 1/m; 0 and inf where unknown.
    """
    known = (rho > 0) & np.isfinite(rho_sigma)
    safe = np.where(known, rho, 1.0)
    across = np.einsum("mii->mi", covariance) / (camera.fx * safe) ** 2
    along = np.where(known, rho_sigma, np.inf) / safe**2
    return pinhole.rays(camera, ends_px) / safe[..., None], np.sqrt(across + along**2)


def seen_stretches(lines: Array, landmark: Array, ends_body: Array) -> Array:
    """Of each line the segment (L, 2, 3), m, between where its ends were seen; NaN: never.

    Args:
        lines: (L, 10), from `packed`.
        landmark: (M,) rows of `lines`, ascending.
        ends_body: (M, 2, 3) the observed ends in the frame of the lines; NaN: without depth.
    """
    plucker = plucker_from_orthonormal(unpacked(lines))
    along = np.einsum("mei,mi->me", ends_body, plucker.direction[landmark])
    start = np.searchsorted(landmark, np.arange(len(lines) + 1))
    stretch = np.full((len(lines), 2), np.nan)
    for n, (first, last) in enumerate(pairwise(start)):
        known = along[first:last][np.isfinite(along[first:last]).all(axis=1)]
        if len(known):
            stretch[n] = np.median(known, axis=0)
    return np.asarray(feet_of_origin(plucker)[:, None]
                      + stretch[..., None] * plucker.direction[:, None])


@numba.njit(cache=True)
def _in_camera(T, line, by):  # type: ignore[no-untyped-def]
    """Fill `by` (6, 11): [N, U] of a line in the camera, and their derivatives by ξ and δ."""
    sine = np.sin(line[9])
    if abs(sine) < _MIN_SINE:
        sine = np.copysign(_MIN_SINE, sine)
    distance = np.cos(line[9]) / sine
    by[:] = 0.0
    for i in range(3):                        # in the body first: the value, then δ at column 7
        u1, u2, u3 = line[3 * i], line[3 * i + 1], line[3 * i + 2]
        by[i, 0], by[3 + i, 0] = distance * u1, u2
        by[i, 8], by[i, 9], by[i, 10] = -distance * u3, distance * u2, -u1 / (sine * sine)
        by[3 + i, 7], by[3 + i, 9] = u3, -u1
    t0, t1, t2 = T[0, 3], T[1, 3], T[2, 3]
    for c in (0, 7, 8, 9, 10):
        u0, u1, u2 = by[3, c], by[4, c], by[5, c]
        n0 = by[0, c] - (t1 * u2 - t2 * u1)
        n1 = by[1, c] - (t2 * u0 - t0 * u2)
        n2 = by[2, c] - (t0 * u1 - t1 * u0)
        for i in range(3):
            by[i, c] = T[0, i] * n0 + T[1, i] * n1 + T[2, i] * n2
            by[3 + i, c] = T[0, i] * u0 + T[1, i] * u1 + T[2, i] * u2
    # ∂N/∂ω = [N]×, ∂N/∂v = ∂U/∂ω = [U]×.
    for row, column, at in ((0, 1, 0), (0, 4, 3), (3, 1, 3)):
        x, y, z = by[at, 0], by[at + 1, 0], by[at + 2, 0]
        by[row, column + 1], by[row, column + 2], by[row + 1, column + 2] = -z, y, -x
        by[row + 1, column], by[row + 2, column], by[row + 2, column + 1] = z, -y, x


@numba.njit(cache=True)
def _line_sighting_rows(T, lines, ends, rho, camera):  # type: ignore[no-untyped-def]
    n = len(lines)
    r, J, V = np.empty((n, 4)), np.zeros((n, 4, 6)), np.zeros((n, 4, 4))
    by = np.empty((6, 11))
    for i in range(n):
        if not line_sighting_row(T[i], lines[i], ends[i], rho[i], camera, r[i], J[i], V[i], by):
            r[i], J[i], V[i] = np.nan, 0.0, 0.0
    return r, J, V


def line_sighting_terms(T_body_camera: Array, lines: Array, ends_px: Array, rho: Array,
                        camera: Pinhole) -> LineTerms:
    """3D line measurement, eq. (5), as the sensor makes it.

    Rows: distances of the observed ends A and B from the image of the line (px, their sign is
    the line's), and inverse depths (1/m) of the line where it passes A and B, predicted minus
    observed. NaN where the line is seen end on or lies behind the camera, and where A = B.

    Args:
        T_body_camera: (N, 4, 4) pose of the camera that sees each line.
        lines: (N, 10) in the body, from `packed`.
        ends_px: (N, 2, 2) observed A and B.
        rho: (N, 2) inverse depths observed there.
    """
    return LineTerms(*_line_sighting_rows(
        np.ascontiguousarray(T_body_camera, dtype=np.float64),
        np.ascontiguousarray(lines, dtype=np.float64),
        np.ascontiguousarray(ends_px, dtype=np.float64),
        np.ascontiguousarray(rho, dtype=np.float64), camera_tuple(camera)))


@numba.njit(cache=True)
def moved_lines(lines, delta):  # type: ignore[no-untyped-def]
    """Lines (N, 10) updated by δ (N, 4) = [θ (3), φ] in radians: U Exp(θ), W R(φ)."""
    out, step = np.empty_like(lines), np.empty((3, 3))
    for n in range(len(lines)):
        exp_so3_row(delta[n], step)
        for i in range(3):
            for j in range(3):
                out[n, 3 * i + j] = (lines[n, 3 * i] * step[0, j] + lines[n, 3 * i + 1] * step[1, j]
                                     + lines[n, 3 * i + 2] * step[2, j])
        out[n, 9] = lines[n, 9] + delta[n, 3]
    return out


@numba.njit(cache=True)
def change_of_lines(before, now):  # type: ignore[no-untyped-def]
    """δ (N, 4) that `moved_lines` needs to take lines `before` to lines `now`, (N, 10) each."""
    out, R = np.empty((len(now), 4)), np.empty((3, 3))
    for n in range(len(now)):
        for i in range(3):
            for j in range(3):
                R[i, j] = (before[n, i] * now[n, j] + before[n, 3 + i] * now[n, 3 + j]
                           + before[n, 6 + i] * now[n, 6 + j])
        log_so3_row(R, out[n])
        out[n, 3] = now[n, 9] - before[n, 9]
    return out
