"""What a frame measures of landmarks: points and the ends of lines in one form.

An end of a map line is not seen itself, for segments break where they like; the line through the
seen segment is. So the end is measured at its foot on that line, precisely across the line and
hardly along it. Points and line ends then enter one solver as one type of measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.dpl.features import KeyLines, KeyPoints
from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.geometry.camera import project
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


def of_line_ends(ends_world: Array, lines: KeyLines, T_world_camera: Array, camera: Intrinsics,
                 sigma_px: float, rho_sigma: float) -> Sightings:
    """Ends of map lines (L, 2, 3), each pair seen as one of L segments: 2 L measurements.

    The foot of each end is taken at the pose given.
    """
    a, b = lines.ends_px[:, 0], lines.ends_px[:, 1]
    along = b - a
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    along = along / length
    xyz = se3.transform_points(se3.inverse(T_world_camera), ends_world.reshape(-1, 3))
    uv = project(camera, xyz).reshape(-1, 2, 2)
    s = np.nan_to_num(np.sum((uv - a[:, None]) * along[:, None], axis=2))       # (L, 2) px
    foot = a[:, None] + s[:, :, None] * along[:, None]
    known = np.asarray((lines.depth_m > 0).all(axis=1))
    ends_rho = 1.0 / np.where(known[:, None], lines.depth_m, 1.0)
    share = s / length
    rho = ends_rho[:, :1] * (1 - share) + ends_rho[:, 1:] * share
    # Beyond the seen segment its depth is guessed, the less certainly the farther.
    beyond = np.maximum(np.abs(share - 0.5) - 0.5, 0.0)
    certain = np.where(known[:, None], 1.0 / (rho_sigma * (1.0 + 4.0 * beyond)), 0.0)
    angled = _line_whitening(along, sigma_px)
    whitening = np.concatenate([np.repeat(angled[:, None], 2, axis=1), certain[:, :, None]], 2)
    return Sightings(foot.reshape(-1, 2), whitening.reshape(-1, 4), rho.reshape(-1))


def _line_whitening(along: Array, sigma_px: float) -> Array:
    """(L, 3): lower triangle of L⁻¹ for Σ = σ² n nᵀ + σ_along² d dᵀ."""
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    cov = (sigma_px**2 * normal[:, :, None] * normal[:, None]
           + _ALONG_PX**2 * along[:, :, None] * along[:, None])
    return whitening_of(cov)
