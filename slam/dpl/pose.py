"""One camera's pose against landmarks that are held: robust Levenberg-Marquardt, compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from slam.dpl.sightings import Sightings
from slam.factors import landmark_row
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.residuals import camera_tuple
from slam.types import Intrinsics

_UNSEEN_CHI2 = 1e4       # what a landmark costs that the camera cannot see


@dataclass(frozen=True, slots=True)
class PoseFit:
    T_world_camera: Array    # (4, 4)
    chi2: Array              # (N,) squared whitened length of each residual; inf where unseen
    information: Array       # (6, 6) of T Exp(ξ)


def refine_pose(T_world_camera: Array, xyz_world: Array, seen: Sightings, camera: Intrinsics,
                kernel_width: float, iterations: int, covariance: Array | None = None) -> PoseFit:
    """Refine a pose so that landmarks (N, 3) fall where they are seen (SDPL eq. 2 and 3's terms).

    A step that does not lower the cost is not taken.

    Args:
        covariance: (N, 3, 3) m² of the landmarks in the world, which adds to the sightings' own as
            it is at the pose given: to first order they are then eliminated. None: exact.
    """
    T = np.ascontiguousarray(T_world_camera, dtype=np.float64)
    xyz = np.ascontiguousarray(xyz_world, dtype=np.float64)
    own = np.ascontiguousarray(seen.whitening)
    uncertain = np.zeros((0, 3, 3)) if covariance is None else np.ascontiguousarray(covariance)
    held = (xyz, np.ascontiguousarray(seen.uv_px), np.ascontiguousarray(seen.rho),
            _whole_whitening(T, xyz, own, uncertain, camera_tuple(camera)),
            camera_tuple(camera), float(kernel_width))
    T, chi2, H = _levenberg_marquardt(T, *held, iterations)
    return PoseFit(se3.orthonormalised(T), chi2, H)


@numba.njit(cache=True)
def _levenberg_marquardt(T, xyz, uv, rho, whitening, camera, width,  # type: ignore[no-untyped-def]
                         iterations):
    damping = 1e-4
    cost, chi2, H, g = _normal_equations(T, xyz, uv, rho, whitening, camera, width)
    step, T_try = np.empty(6), T.copy()
    for _ in range(iterations):
        if not _solve(H, g, damping, step):
            break
        _moved(T, step, T_try)
        cost_try, chi2_try, H_try, g_try = _normal_equations(T_try, xyz, uv, rho, whitening,
                                                             camera, width)
        if not cost_try < cost:
            damping *= 30.0
            if damping > 1e4:
                break
            continue
        ended = cost - cost_try < 1e-5 * cost
        T, T_try = T_try, T.copy()
        cost, chi2, H, g = cost_try, chi2_try, H_try, g_try
        damping = max(damping * 0.1, 1e-9)
        if ended:
            break
    return T, chi2, H


@numba.njit(cache=True)
def _solve(H, g, damping, step):  # type: ignore[no-untyped-def]
    """step (6,) = −(H + damping diag H)⁻¹ g by Cholesky; False where H is not positive."""
    L = np.zeros((6, 6))
    for i in range(6):
        for j in range(i + 1):
            total = H[i, j]
            if i == j:
                total += damping * H[i, i] + 1e-9
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0:
                L[i, i] = np.sqrt(total)
            else:
                return False
    for i in range(6):
        total = -g[i]
        for k in range(i):
            total -= L[i, k] * step[k]
        step[i] = total / L[i, i]
    for i in range(5, -1, -1):
        total = step[i]
        for k in range(i + 1, 6):
            total -= L[k, i] * step[k]
        step[i] = total / L[i, i]
    return True


@numba.njit(cache=True)
def _moved(T, step, out):  # type: ignore[no-untyped-def]
    """out = T Exp(ξ), as `se3.exp`."""
    x, y, z = step[0], step[1], step[2]
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    if angle < 1e-4:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a = np.sin(angle) / angle
        b = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        c = (1.0 - a) / angle2
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    R, V = np.eye(3), np.eye(3)
    for i in range(3):
        for j in range(3):
            square = S[i, 0] * S[0, j] + S[i, 1] * S[1, j] + S[i, 2] * S[2, j]
            R[i, j] += a * S[i, j] + b * square
            V[i, j] += b * S[i, j] + c * square
    for i in range(3):
        out[i, 3] = T[i, 3]
        for j in range(3):
            out[i, j] = T[i, 0] * R[0, j] + T[i, 1] * R[1, j] + T[i, 2] * R[2, j]
            out[i, 3] += T[i, j] * (V[j, 0] * step[3] + V[j, 1] * step[4] + V[j, 2] * step[5])


@numba.njit(cache=True)
def _whole_whitening(T, xyz, whitening, covariance, camera):  # type: ignore[no-untyped-def]
    """(N, 6): lower triangle by rows of L⁻¹, L Lᵀ = Σ + V P Vᵀ, P the landmark's covariance."""
    n = len(xyz)
    out = np.zeros((n, 6))
    r, J, V = np.empty(3), np.zeros((3, 6)), np.empty((3, 3))
    none, S, VP = np.zeros(2), np.empty((3, 3)), np.empty((3, 3))
    for i in range(n):
        l00, l10, l11, l22 = whitening[i]
        if len(covariance) == 0 or not landmark_row(T, xyz[i], none, 0.0, camera, r, J, V):
            out[i, 0], out[i, 1], out[i, 2], out[i, 5] = l00, l10, l11, l22
            continue
        for a in range(3):
            for b in range(3):
                VP[a, b] = 0.0
                for k in range(3):
                    VP[a, b] += V[a, k] * covariance[i, k, b]
        for a in range(3):
            for b in range(a + 1):
                S[a, b] = VP[a, 0] * V[b, 0] + VP[a, 1] * V[b, 1] + VP[a, 2] * V[b, 2]
        # Σ of the pixel from its whitening: (L⁻¹ᵀ L⁻¹)⁻¹.
        uu, vv = 1.0 / l00, 1.0 / l11
        vu = -l10 * uu * vv
        S[0, 0] += uu * uu
        S[1, 0] += uu * vu
        S[1, 1] += vu * vu + vv * vv
        m00 = np.sqrt(S[0, 0])
        m10 = S[1, 0] / m00
        m11 = np.sqrt(max(S[1, 1] - m10 * m10, 1e-12))
        out[i, 0], out[i, 1], out[i, 2] = 1.0 / m00, -m10 / (m00 * m11), 1.0 / m11
        if l22 <= 0.0:
            continue
        m20 = S[2, 0] / m00
        m21 = (S[2, 1] - m20 * m10) / m11
        m22 = np.sqrt(max(S[2, 2] + 1.0 / (l22 * l22) - m20 * m20 - m21 * m21, 1e-18))
        out[i, 3] = -(m20 * out[i, 0] + m21 * out[i, 1]) / m22
        out[i, 4], out[i, 5] = -m21 * out[i, 2] / m22, 1.0 / m22
    return out


@numba.njit(cache=True)
def _normal_equations(T, xyz, uv, rho, whitening, camera, width):  # type: ignore[no-untyped-def]
    """Cost, chi2 (N,), H (6, 6) and g (6,) with Cauchy's kernel."""
    n = len(xyz)
    chi2, H, g, cost = np.empty(n), np.zeros((6, 6)), np.zeros(6), 0.0
    r, J, V, rw, Jw = np.empty(3), np.zeros((3, 6)), np.empty((3, 3)), np.empty(3), np.empty((3, 6))
    for i in range(n):
        if not landmark_row(T, xyz[i], uv[i], rho[i], camera, r, J, V):
            chi2[i] = np.inf
            cost += width * width * np.log1p(_UNSEEN_CHI2 / (width * width))
            continue
        l00, l10, l11, l20, l21, l22 = whitening[i]
        rw[0], rw[1] = l00 * r[0], l10 * r[0] + l11 * r[1]
        rw[2] = l20 * r[0] + l21 * r[1] + l22 * r[2]
        for c in range(6):
            Jw[0, c] = l00 * J[0, c]
            Jw[1, c] = l10 * J[0, c] + l11 * J[1, c]
            Jw[2, c] = l20 * J[0, c] + l21 * J[1, c] + l22 * J[2, c]
        total = rw[0] * rw[0] + rw[1] * rw[1] + rw[2] * rw[2]
        chi2[i] = total
        weight = 1.0 / (1.0 + total / (width * width))
        cost += width * width * np.log1p(total / (width * width))
        for a in range(6):
            for k in range(3):
                g[a] += weight * Jw[k, a] * rw[k]
                for c in range(a, 6):
                    H[a, c] += weight * Jw[k, a] * Jw[k, c]
    for a in range(6):
        for c in range(a):
            H[a, c] = H[c, a]
    return cost, chi2, H, g
