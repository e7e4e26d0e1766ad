"""Inverse depth of the surface around features: planes fitted to small windows of the depth image.

Inverse depth is linear in the image of a plane, so the fit is exact there, averages the noise of
all the window's pixels, and its slope tells how the surface is inclined.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array

_RADIUS_PX = 3            # 7×7 windows: small against the face of a box, large against noise
_MAX_STEP = 0.08          # relative: farther from the window's median is another surface
_TRIM = 2.5               # robust standard deviations from the first plane


@dataclass(frozen=True, slots=True)
class SurfacePatches:
    rho: Array            # (N,) 1/m at the feature; 0 where no surface was found
    slope: Array          # (N, 2) ∂ρ/∂(u, v), 1/m/px
    gain: Array           # (N,) standard deviation of `rho` over that of one pixel's


def fit_surfaces(rho: Array, label_index: Array, uv_px: Array) -> SurfacePatches:
    """Fit ρ = ρ₀ + slope · (m − uv) to the pixels around each feature that lie on its surface.

    Args:
        rho: (H, W) float32 inverse depth, 0 = unknown.
        label_index: (H, W) uint8; only pixels with the label of the feature's own pixel count.
        uv_px: (N, 2).
    """
    height, width = rho.shape
    n = len(uv_px)
    if n == 0:
        return SurfacePatches(np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    safe = np.where(np.isfinite(uv_px), uv_px, -1e6)
    centre = np.rint(np.clip(safe, -1e6, 1e6)).astype(np.int64)
    inside = ((centre >= 0) & (centre < [width, height])).all(axis=1)
    centre = np.clip(centre, 0, [width - 1, height - 1])
    offset = np.arange(-_RADIUS_PX, _RADIUS_PX + 1)
    du, dv = (x.ravel() for x in np.meshgrid(offset, offset))
    column = np.clip(centre[:, :1] + du, 0, width - 1)
    row = np.clip(centre[:, 1:] + dv, 0, height - 1)
    index = row * width + column
    values = rho.ravel()[index].astype(np.float64)
    label = label_index.ravel()[index]
    own = label_index[centre[:, 1], centre[:, 0]]
    usable = (values > 0) & (label == own[:, None])
    # A clipped window names border pixels twice; their own coordinates keep the plane right.
    x, y = column - uv_px[:, :1], row - uv_px[:, 1:]
    middle = _masked_median(values, usable)
    near = usable & (np.abs(values - middle[:, None]) <= _MAX_STEP * middle[:, None])
    plane, _ = _fit(values, near, x, y)
    residual = np.abs(values - _evaluate(plane, x, y))
    spread = 1.4826 * _masked_median(residual, near)
    near &= residual <= np.maximum(_TRIM * spread, 1e-5 * middle)[:, None]
    plane, variance = _fit(values, near, x, y)
    good = inside & (near.sum(axis=1) >= 6) & (plane[:, 0] > 0)
    return SurfacePatches(np.where(good, plane[:, 0], 0.0),
                          np.where(good[:, None], plane[:, 1:], 0.0),
                          np.where(good, np.sqrt(variance), 1.0))


def _masked_median(values: Array, mask: Array) -> Array:
    """Median over the last axis of what the mask picks; 0 where it picks nothing."""
    count = mask.sum(axis=1)
    ordered = np.sort(np.where(mask, values, np.inf), axis=1)
    middle = ordered[np.arange(len(values)), np.minimum(count // 2, values.shape[1] - 1)]
    return np.where(count > 0, middle, 0.0)


def _fit(values: Array, mask: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Least-squares planes (N, 3), and the variance (N,) at the origin for unit noise."""
    w = mask.astype(np.float64)
    wx, wy = w * x, w * y
    A = np.empty((len(values), 3, 3))
    A[:, 0, 0] = w.sum(axis=1)
    A[:, 0, 1] = A[:, 1, 0] = wx.sum(axis=1)
    A[:, 0, 2] = A[:, 2, 0] = wy.sum(axis=1)
    A[:, 1, 1] = (wx * x).sum(axis=1)
    A[:, 1, 2] = A[:, 2, 1] = (wx * y).sum(axis=1)
    A[:, 2, 2] = (wy * y).sum(axis=1)
    b = np.stack([(w * values).sum(axis=1), (wx * values).sum(axis=1),
                  (wy * values).sum(axis=1)], axis=1)
    A += np.diag([1e-9, 1e-3, 1e-3])      # a window of one row has no slope across it
    inverse = np.linalg.inv(A)
    return np.einsum("nij,nj->ni", inverse, b), inverse[:, 0, 0]


def _evaluate(plane: Array, x: Array, y: Array) -> Array:
    return plane[:, :1] + plane[:, 1:2] * x + plane[:, 2:] * y
