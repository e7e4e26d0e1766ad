"""Noise of the colour camera: exposure, shot noise, read noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class RgbNoise:
    """Variance in grey levels²: level · 255 / full_well_e + read_dn² (levels taken as linear)."""

    full_well_e: float = 10_000.0    # electrons at level 255; 0: no shot noise
    read_dn: float = 1.0             # σ of the read noise in grey levels
    gain: float = 1.0                # brightness: > 1 is overexposed, < 1 underexposed


def apply_rgb_noise(rgb: Array, noise: RgbNoise | None, rng: np.random.Generator) -> Array:
    """(H, W, 3) uint8 image with exposure and noise; a new array."""
    if noise is None:
        return np.array(rgb, np.uint8)
    level = np.arange(256, dtype=np.float32) * np.float32(noise.gain)
    level = np.minimum(level, np.float32(255.0))
    shot = 255.0 / noise.full_well_e if noise.full_well_e > 0 else 0.0
    sigma = np.sqrt(level * np.float32(shot) + np.float32(noise.read_dn) ** 2)
    noisy = rng.standard_normal(np.shape(rgb), dtype=np.float32)
    noisy *= sigma[rgb]
    noisy += level[rgb]
    np.rint(noisy, out=noisy)
    return np.clip(noisy, 0.0, 255.0, out=noisy).astype(np.uint8)
