"""Pictures averaged as a sensor averages them: in linear light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.geometry.arrays import Array


def mean_in_linear_light(pictures: Sequence[Array]) -> Array:
    """(H, W, 3) uint8 sRGB mean of at least one picture of that form."""
    light = np.zeros(pictures[0].shape, np.float32)
    for picture in pictures:
        light += _LINEAR_OF_SRGB[picture]
    return _srgb_of_linear(light / np.float32(len(pictures)))


def _linear_table() -> Array:
    """(256,) float32 linear light of each sRGB byte (IEC 61966-2-1)."""
    value = np.arange(256) / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


_LINEAR_OF_SRGB = _linear_table()


def _srgb_of_linear(light: Array) -> Array:
    value = np.where(light <= 0.0031308, 12.92 * light,
                     1.055 * np.maximum(light, 1e-9) ** (1.0 / 2.4) - 0.055)
    return np.clip(np.rint(255.0 * value), 0, 255).astype(np.uint8)
