"""The pinhole camera: projection, its derivative, and back-projection.

Pixel centres are at integer coordinates; depth is planar z in metres.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from slam.geometry.arrays import Array


class Pinhole(Protocol):
    """Anything with focal lengths and a principal point, in pixels."""

    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...


def project(camera: Pinhole, xyz: Array) -> Array:
    """Project points (..., 3) in the camera's frame to pixels (..., 2): π(·).

    A point with z ≤ 0 has no image: its pixel is NaN.
    """
    xyz = np.asarray(xyz, dtype=np.float64)
    z = np.where(xyz[..., 2] > 0.0, xyz[..., 2], np.nan)
    return np.stack([camera.fx * xyz[..., 0] / z + camera.cx,
                     camera.fy * xyz[..., 1] / z + camera.cy], axis=-1)


def project_jacobian(camera: Pinhole, xyz: Array) -> Array:
    """∂π/∂xyz (..., 2, 3) at points (..., 3) in front of the camera."""
    xyz = np.asarray(xyz, dtype=np.float64)
    inv_z = 1.0 / xyz[..., 2]
    J = np.zeros((*xyz.shape[:-1], 2, 3))
    J[..., 0, 0] = camera.fx * inv_z
    J[..., 0, 2] = -camera.fx * xyz[..., 0] * inv_z**2
    J[..., 1, 1] = camera.fy * inv_z
    J[..., 1, 2] = -camera.fy * xyz[..., 1] * inv_z**2
    return J


def rays(camera: Pinhole, uv_px: Array) -> Array:
    """Directions (..., 3) with z = 1 through pixels (..., 2)."""
    uv = np.asarray(uv_px, dtype=np.float64)
    out = np.ones((*uv.shape[:-1], 3))
    out[..., 0] = (uv[..., 0] - camera.cx) / camera.fx
    out[..., 1] = (uv[..., 1] - camera.cy) / camera.fy
    return out


def back_project(camera: Pinhole, uv_px: Array, depth_m: Array) -> Array:
    """Points (..., 3) in the camera's frame from pixels (..., 2) and z-depths (...)."""
    return rays(camera, uv_px) * np.asarray(depth_m, dtype=np.float64)[..., None]
