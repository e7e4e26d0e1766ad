"""Inverse depth of the surface around features: planes fitted to small windows of the depth image.

Inverse depth is linear in the image of a plane, so the fit is exact there, averages the noise of
all the window's pixels, and its slope tells how the surface is inclined.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole

_RADIUS_PX = 3            # 7×7 windows: small against the face of a box, large against noise
_MAX_STEP = 0.08          # relative: farther from the middle pixel is another surface
_NOISE_STEP = 4.0         # and so many standard deviations of the depth noise are allowed besides
_TRIM = 2.5               # standard deviations from the first plane
_MIN_PIXELS = 6


@dataclass(frozen=True, slots=True)
class SurfacePatches:
    rho: Array            # (N,) 1/m at the feature; 0 where no surface was found
    slope: Array          # (N, 2) ∂ρ/∂(u, v), 1/m/px
    gain: Array           # (N,) standard deviation of `rho` over that of one pixel's


def fit_surfaces(rho: Array, label_index: Array, uv_px: Array,
                 inverse_depth_sigma: float) -> SurfacePatches:
    """Fit ρ = ρ₀ + slope · (m − uv) to the pixels around each feature that lie on its surface.

    Args:
        rho: (H, W) float32 inverse depth, 0 = unknown.
        label_index: (H, W) uint8; only pixels with the label of the feature's own pixel count.
        uv_px: (N, 2).
        inverse_depth_sigma: of one pixel, 1/m.
    """
    out = _fit_all(np.ascontiguousarray(rho), np.ascontiguousarray(label_index),
                   np.ascontiguousarray(uv_px, dtype=np.float64), inverse_depth_sigma)
    return SurfacePatches(out[:, 0], out[:, 1:3], out[:, 3])


def carried(camera: Pinhole, uv: Array, rho: Array, slope: Array, T_b_a: Array
            ) -> tuple[Array, Array, Array]:
    """Where motions put pixels on inclined surfaces, and how they deform the image there.

    Args:
        uv, rho, slope: (N, 2) px, (N,) 1/m and (N, 2) ∂ρ/∂uv in camera a.
        T_b_a: (N, 4, 4) from camera a to b.
    Returns:
        uv (N, 2) and inverse depths (N,) in b (< 0 behind it), warps (N, 2, 2).
    """
    R, t = T_b_a[:, :3, :3], T_b_a[:, :3, 3]
    moved = np.einsum("nij,nj->ni", R, pinhole.rays(camera, uv)) + rho[:, None] * t
    safe = np.where(moved[:, 2:] > 1e-6, moved, [0.0, 0.0, 1.0])
    per_pixel = R[:, :, :2] / np.array([camera.fx, camera.fy])
    warp = pinhole.project_jacobian(camera, safe) @ (per_pixel
                                                     + t[:, :, None] * slope[:, None, :])
    rho_b = np.where(moved[:, 2] > 1e-6, rho / safe[:, 2], -1.0)
    return pinhole.project(camera, safe), rho_b, warp


@numba.njit(cache=True, nogil=True)
def _fit_all(rho: Array, label_index: Array, uv: Array, sigma: float) -> Array:
    """(N, 4): ρ₀, slope u, slope v, gain; ρ₀ = 0 and gain 1 where there is no fit."""
    height, width = rho.shape
    out = np.zeros((len(uv), 4))
    out[:, 3] = 1.0
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        middle = rho[row, column]
        if middle <= 0.0:
            continue
        window = (max(row - _RADIUS_PX, 0), min(row + _RADIUS_PX + 1, height),
                  max(column - _RADIUS_PX, 0), min(column + _RADIUS_PX + 1, width))
        # First all pixels near the middle one's depth, then those near the plane through them.
        flat = (middle, 0.0, 0.0)
        step = _MAX_STEP * middle + _NOISE_STEP * sigma
        plane, spread, count, _ = _fit(rho, label_index, window, u, v, row, column, flat, step)
        if count < _MIN_PIXELS:
            continue
        step = max(_TRIM * spread, 1e-5 * middle)
        plane, _, count, gain = _fit(rho, label_index, window, u, v, row, column, plane, step)
        if count >= _MIN_PIXELS and plane[0] > 0.0:
            out[n] = plane[0], plane[1], plane[2], gain
    return out


@numba.njit(cache=True, nogil=True)
def _fit(rho, label_index, window, u, v, row, column, near, step):  # type: ignore[no-untyped-def]
    """Least-squares plane of the window's pixels within `step` of the plane `near`.

    Returns:
        the plane at (u, v), the RMS of its residuals, the pixels used, the gain at (u, v).
    """
    s = sx = sy = sxx = sxy = syy = sz = szx = szy = szz = 0.0
    for i in range(window[0], window[1]):
        y = i - v
        for j in range(window[2], window[3]):
            if label_index[i, j] != label_index[row, column] or rho[i, j] <= 0.0:
                continue
            x = j - u
            z = rho[i, j] - (near[0] + near[1] * x + near[2] * y)
            if abs(z) > step:
                continue
            s += 1.0
            sx += x
            sy += y
            sxx += x * x
            sxy += x * y
            syy += y * y
            sz += z
            szx += z * x
            szy += z * y
            szz += z * z
    # Solve the 3×3 normal equations; a window of one row gets no slope across it.
    sxx += 1e-3
    syy += 1e-3
    a00, a01, a02 = sxx * syy - sxy * sxy, sy * sxy - sx * syy, sx * sxy - sy * sxx
    a11, a12, a22 = (s * syy - sy * sy), (sx * sy - s * sxy), (s * sxx - sx * sx)
    det = s * a00 + sx * a01 + sy * a02
    if s < _MIN_PIXELS or det <= 1e-9:
        return near, 0.0, 0, 1.0
    d0 = (a00 * sz + a01 * szx + a02 * szy) / det
    d1 = (a01 * sz + a11 * szx + a12 * szy) / det
    d2 = (a02 * sz + a12 * szx + a22 * szy) / det
    rest = max(szz - d0 * sz - d1 * szx - d2 * szy, 0.0)
    plane = (near[0] + d0, near[1] + d1, near[2] + d2)
    return plane, np.sqrt(rest / s), int(s), np.sqrt(a00 / det)
