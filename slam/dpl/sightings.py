"""What a frame measures of landmarks: points and the ends of lines in one form.

An end of a map line is not seen itself, for segments break where they like; the line through the
seen segment is. So the end is measured at its foot on that line, precisely across the line and
hardly along it. Points and line ends then enter one solver as one type of measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from slam.dpl.features import KeyLines, KeyPoints
from slam.geometry.arrays import Array, freeze_fields
from slam.residuals import camera_tuple
from slam.types import Intrinsics

_ALONG_PX = 30.0         # standard deviation of an end along its line


@dataclass(frozen=True, slots=True)
class Sightings:
    """N measurements of landmarks in one frame."""

    uv_px: Array         # (N, 2)
    whitening: Array     # (N, 4): lower triangle (uu, vu, vv) of L⁻¹, Σ = L Lᵀ px²; 1/σ of ρ
    rho: Array           # (N,) 1/m, inverse depth

    def __post_init__(self) -> None:
        freeze_fields(self, uv_px=("N", 2), whitening=("N", 4), rho=("N",))

    def __len__(self) -> int:
        return len(self.uv_px)


def joined(*parts: Sightings) -> Sightings:
    return Sightings(*(np.concatenate([getattr(p, name) for p in parts])
                       for name in Sightings.__slots__))


def of_points(points: KeyPoints, sigma_px: float, scale: float, rho_sigma: float) -> Sightings:
    """Points: σ of those not aligned grows with the pyramid level."""
    n = len(points)
    across = 1.0 / (sigma_px * scale ** points.level.astype(np.float64))
    known = points.depth_m > 0
    whitening = np.stack([across, np.zeros(n), across, np.where(known, 1.0 / rho_sigma, 0.0)], 1)
    if points.whitening is not None:
        aligned = points.whitening[:, 0] > 0
        whitening[aligned, :3] = points.whitening[aligned, :3]
        told = known & (points.whitening[:, 3] > 0)
        whitening[told, 3] = points.whitening[told, 3]
    return Sightings(points.uv_px, whitening,
                     np.where(known, 1.0 / np.where(known, points.depth_m, 1.0), 0.0))


def whitening_of(covariance: Array) -> Array:
    """(N, 3): lower triangle (uu, vu, vv) of L⁻¹ for covariances (N, 2, 2) = L Lᵀ."""
    l00 = np.sqrt(covariance[:, 0, 0])
    l10 = covariance[:, 1, 0] / l00
    l11 = np.sqrt(np.maximum(covariance[:, 1, 1] - l10**2, 1e-12))
    return np.stack([1.0 / l00, -l10 / (l00 * l11), 1.0 / l11], axis=1)


def covariance_of(whitening: Array) -> Array:
    """(N, 2, 2) px²: L Lᵀ for lower triangles (uu, vu, vv) of L⁻¹, the first of (N, ≥ 3)."""
    uu, vv = 1.0 / whitening[:, 0], 1.0 / whitening[:, 2]
    vu = -whitening[:, 1] * uu * vv
    return np.stack([np.stack([uu * uu, uu * vu], 1),
                     np.stack([uu * vu, vu * vu + vv * vv], 1)], 1)


def of_line_ends(ends_world: Array, lines: KeyLines, T_world_camera: Array, camera: Intrinsics,
                 sigma_px: float, rho_sigma: float) -> Sightings:
    """Ends of map lines (L, 2, 3), each pair seen as one of L segments: 2 L measurements.

    The foot of each end is taken at the pose given.
    """
    return Sightings(*_of_line_ends(
        np.ascontiguousarray(ends_world), np.ascontiguousarray(lines.ends_px),
        np.ascontiguousarray(lines.depth_m), np.ascontiguousarray(T_world_camera),
        camera_tuple(camera), sigma_px, rho_sigma))


@numba.njit(cache=True, nogil=True)
def _of_line_ends(ends, seen, depth, T, camera, sigma_px, rho_sigma):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = camera
    n = len(ends)
    foot, whitening, rho = np.empty((2 * n, 2)), np.empty((2 * n, 4)), np.empty(2 * n)
    x = np.empty(3)
    for i in range(n):
        au, av = seen[i, 0, 0], seen[i, 0, 1]
        du, dv = seen[i, 1, 0] - au, seen[i, 1, 1] - av
        length = max(np.sqrt(du * du + dv * dv), 1e-9)
        du, dv = du / length, dv / length
        # Lower triangle of L⁻¹ for Σ = L Lᵀ = σ² n nᵀ + σ_along² d dᵀ.
        across2, along2 = sigma_px * sigma_px, _ALONG_PX * _ALONG_PX
        l00 = np.sqrt(across2 * dv * dv + along2 * du * du)
        l10 = (along2 - across2) * du * dv / l00
        l11 = np.sqrt(max(across2 * du * du + along2 * dv * dv - l10 * l10, 1e-12))
        known = depth[i, 0] > 0 and depth[i, 1] > 0
        for e in range(2):
            k = 2 * i + e
            for row in range(3):
                x[row] = 0.0
                for column in range(3):
                    x[row] += T[column, row] * (ends[i, e, column] - T[column, 3])
            s = 0.0                      # px along the segment; an end that has no image: its start
            if x[2] > 0.0:
                s = (fx * x[0] / x[2] + cx - au) * du + (fy * x[1] / x[2] + cy - av) * dv
            foot[k, 0], foot[k, 1] = au + s * du, av + s * dv
            whitening[k, 0], whitening[k, 1] = 1.0 / l00, -l10 / (l00 * l11)
            whitening[k, 2], whitening[k, 3] = 1.0 / l11, 0.0
            rho[k] = 0.0
            if known:
                share = s / length
                rho[k] = (1.0 - share) / depth[i, 0] + share / depth[i, 1]
                # Beyond the seen segment its depth is guessed, the less certainly the farther.
                beyond = max(abs(share - 0.5) - 0.5, 0.0)
                whitening[k, 3] = 1.0 / (rho_sigma * (1.0 + 4.0 * beyond))
    return foot, whitening, rho
