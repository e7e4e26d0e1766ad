"""Noise models of depth cameras. Truth goes in and stays as it is; a new image comes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simbench.sensors.fields import noise_field
from simbench.sensors.surface import depth_borders, incidence_angle, second_view_shadow
from slam.geometry.arrays import Array
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class GaussianDepth:
    """White noise that grows with the square of the depth: the setting of the accuracy tables."""

    sigma_m_at_1m: float = 0.002      # σ_z = sigma_m_at_1m · z²


@dataclass(frozen=True, slots=True)
class KinectDepth:
    """Structured light: axial and lateral noise of Nguyen et al. 2012, steps of Khoshelham 2012.

    σ_z = base + slope (z − offset)² [+ grazing z^(−1/2) θ² / (π/2 − θ)² beyond 60°]
    σ_L = lateral + lateral_grazing θ / (π/2 − θ) pixels
    """

    axial_base_m: float = 0.0012
    axial_slope: float = 0.0019
    axial_offset_m: float = 0.4
    axial_grazing_m: float = 0.0001
    lateral_px: float = 0.8
    lateral_grazing_px: float = 0.035
    disparity_step_m_at_1m: float = 0.00285   # Δz = this · z²; 0: no disparity steps
    baseline_m: float = 0.075                 # camera to projector: its shadows are holes
    border_jump: float = 0.05                 # relative depth step that is a border
    border_holes: float = 0.5                 # share of border pixels without depth
    grazing_start_deg: float = 70.0           # holes begin here …
    grazing_end_deg: float = 84.0             # … and nothing is measured beyond
    min_m: float = 0.4
    max_m: float = 8.0
    quantum_m: float = 0.001                  # of the 16-bit output


@dataclass(frozen=True, slots=True)
class StereoDepth:
    """Active stereo: noise of disparity, smooth over the matching window.

    σ_z = z² · subpixel_px / (fx · baseline_m)
    """

    subpixel_px: float = 0.08
    baseline_m: float = 0.05
    correlation_px: float = 1.5               # σ of the smoothing by the matching window
    disparity_step_px: float = 1.0 / 32.0
    border_jump: float = 0.05
    border_holes: float = 0.25
    grazing_start_deg: float = 78.0
    grazing_end_deg: float = 88.0
    min_m: float = 0.3
    max_m: float = 10.0
    quantum_m: float = 0.001


DepthModel = GaussianDepth | KinectDepth | StereoDepth


def apply_depth_noise(depth_m: Array, intrinsics: Intrinsics, model: DepthModel | None,
                      rng: np.random.Generator) -> Array:
    """(H, W) float32 depth in metres as the sensor gives it; 0 where it gives none.

    Args:
        depth_m: (H, W) float32 true z-depth in metres, 0 where nothing is seen.
        model: None for a perfect sensor.
    """
    depth_m = np.asarray(depth_m, np.float32)
    if model is None:
        return depth_m.copy()
    if isinstance(model, GaussianDepth):
        return _gaussian(depth_m, model, rng)
    angle = incidence_angle(depth_m, intrinsics)
    noisy = (_kinect(depth_m, angle, model, rng) if isinstance(model, KinectDepth)
             else _stereo(depth_m, intrinsics, model, rng))
    noisy[_holes(depth_m, angle, intrinsics, model, rng)] = 0.0
    return _as_16_bit(noisy, model)


def depth_sigma(depth_m: Array, intrinsics: Intrinsics, model: DepthModel | None) -> Array:
    """(H, W) float32 standard deviation of the axial noise in metres; 0 where nothing is seen."""
    depth_m = np.asarray(depth_m, np.float32)
    if model is None:
        return np.zeros_like(depth_m)
    if isinstance(model, GaussianDepth):
        return np.asarray(np.float32(model.sigma_m_at_1m) * depth_m**2)
    if isinstance(model, StereoDepth):
        per_square = model.subpixel_px / (intrinsics.fx * model.baseline_m)
        return np.asarray(np.float32(per_square) * depth_m**2)
    return _kinect_axial_sigma(depth_m, incidence_angle(depth_m, intrinsics), model)


def clean_depth(depth_m: Array) -> Array:
    """(H, W) float32 depth with NaN, infinite and negative values set to 0."""
    depth_m = np.asarray(depth_m, np.float32)
    return np.where((depth_m > 0) & (depth_m < np.inf), depth_m, np.float32(0.0))


def _gaussian(depth_m: Array, model: GaussianDepth, rng: np.random.Generator) -> Array:
    noise = noise_field(rng, depth_m.shape, 1)[..., 0]
    noise *= depth_m
    noise *= np.float32(model.sigma_m_at_1m)
    noise += 1.0
    noise *= depth_m
    return np.maximum(noise, 0.0, out=noise)


def _kinect_axial_sigma(depth_m: Array, angle: Array, model: KinectDepth) -> Array:
    seen = depth_m > 0
    sigma = model.axial_base_m + model.axial_slope * (depth_m - model.axial_offset_m) ** 2
    steep = seen & (angle > np.deg2rad(60.0))
    t = np.minimum(angle[steep], np.deg2rad(89.0))
    sigma[steep] += model.axial_grazing_m / np.sqrt(depth_m[steep]) * (t / (np.pi / 2 - t)) ** 2
    return np.where(seen, sigma, 0.0).astype(np.float32)


def _kinect(depth_m: Array, angle: Array, model: KinectDepth,
            rng: np.random.Generator) -> Array:
    noise = noise_field(rng, depth_m.shape, 3)
    seen_at = _jittered(depth_m, angle, model, noise[..., :2])
    step = np.float32(model.disparity_step_m_at_1m)
    sigma = _kinect_axial_sigma(seen_at, angle, model)
    # The published σ holds the steps of disparity: what they add (Δ/√12) is taken off here.
    spread = np.sqrt(np.maximum(sigma**2 - (step * seen_at**2) ** 2 / 12.0, 0.0))
    noisy = seen_at + spread * noise[..., 2]
    if step <= 0:
        return np.maximum(noisy, 0.0)
    measured = noisy > 0
    disparity = np.rint(np.divide(1.0 / step, noisy, out=np.zeros_like(noisy), where=measured))
    return np.divide(1.0 / step, disparity, out=np.zeros_like(noisy), where=disparity > 0)


def _jittered(depth_m: Array, angle: Array, model: KinectDepth, noise: Array) -> Array:
    """Depth read at the pixel that the lateral noise leads to; 0 where nothing is seen."""
    t = np.minimum(angle, np.float32(np.deg2rad(89.0)))
    sigma_px = model.lateral_px + model.lateral_grazing_px * t / (np.float32(np.pi / 2) - t)
    shift = np.rint(noise * sigma_px[..., None]).astype(np.int32)
    height, width = depth_m.shape
    u = np.clip(np.arange(width, dtype=np.int32) + shift[..., 0], 0, width - 1)
    v = np.clip(np.arange(height, dtype=np.int32)[:, None] + shift[..., 1], 0, height - 1)
    return np.where(depth_m > 0, depth_m[v, u], np.float32(0.0))


def _stereo(depth_m: Array, intrinsics: Intrinsics, model: StereoDepth,
            rng: np.random.Generator) -> Array:
    scale = np.float32(intrinsics.fx * model.baseline_m)
    seen = depth_m > 0
    disparity = np.divide(scale, depth_m, out=np.zeros_like(depth_m), where=seen)
    noise = noise_field(rng, depth_m.shape, 1, model.correlation_px)[..., 0]
    disparity += np.float32(model.subpixel_px) * noise
    if model.disparity_step_px > 0:
        step = np.float32(model.disparity_step_px)
        disparity = np.rint(disparity / step) * step
    return np.divide(scale, disparity, out=np.zeros_like(depth_m), where=seen & (disparity > 0))


def _holes(depth_m: Array, angle: Array, intrinsics: Intrinsics,
           model: KinectDepth | StereoDepth, rng: np.random.Generator) -> Array:
    """(H, W) bool: where the sensor finds nothing: second view's shadow, borders, steep slopes."""
    chance = rng.random((2, *depth_m.shape), dtype=np.float32)
    start, end = np.deg2rad(model.grazing_start_deg), np.deg2rad(model.grazing_end_deg)
    grazing = chance[0] < (angle - np.float32(start)) / np.float32(end - start)
    border = depth_borders(depth_m, model.border_jump) & (chance[1] < model.border_holes)
    return np.asarray(second_view_shadow(depth_m, intrinsics.fx, model.baseline_m)
                      | border | grazing)


def _as_16_bit(depth_m: Array, model: KinectDepth | StereoDepth) -> Array:
    """Cut to the sensor's range and to multiples of its quantum; beyond 65534 of them is 0."""
    inside = (depth_m >= model.min_m) & (depth_m <= model.max_m)
    if model.quantum_m > 0:
        counts = np.rint(depth_m / np.float32(model.quantum_m))
        inside &= counts < 65535
        depth_m = counts * np.float32(model.quantum_m)
    return np.where(inside, depth_m, np.float32(0.0)).astype(np.float32)
