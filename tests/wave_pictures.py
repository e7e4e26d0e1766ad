"""Images whose motion is known exactly: sums of waves, integrated over each pixel."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array


def waves(seed: int, count: int = 40, frequency: float = 0.1) -> tuple[Array, Array]:
    """Frequencies (count, 2) in cycles per pixel, below 0.35, and phases (count,)."""
    rng = np.random.default_rng(seed)
    found = np.clip(rng.normal(size=(count, 2)) * frequency, -0.35, 0.35)
    return found, rng.uniform(0.0, 2.0 * np.pi, count)


def picture(seed: int = 0, shift: tuple[float, float] = (0.0, 0.0),
            size: tuple[int, int] = (160, 200), contrast: float = 50.0, gain: float = 1.0,
            offset: float = 0.0, noise: float = 0.0) -> Array:
    """(H, W) uint8 wavy texture, moved by `shift` (u, v) px."""
    frequencies, phases = waves(seed)
    u, v = np.arange(size[1]) - shift[0], np.arange(size[0]) - shift[1]
    image = np.zeros(size)
    for (fu, fv), phase in zip(frequencies, phases, strict=True):
        a, b = 2 * np.pi * fu * u + phase, 2 * np.pi * fv * v
        image += np.sinc(fu) * np.sinc(fv) * (np.outer(np.cos(b), np.sin(a))
                                              + np.outer(np.sin(b), np.cos(a)))
    image *= contrast / np.sqrt(len(phases))
    image = 128.0 + gain * image + offset
    # The noise's seed depends on the shift, so that two pictures do not share it.
    rng = np.random.default_rng([seed, *np.abs(np.array(shift) * 1e3).astype(int)])
    image += noise * rng.normal(size=size)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def lattice(size: tuple[int, int], step: int = 9, margin: int = 14) -> Array:
    """(N, 2) positions spread over an image."""
    v, u = np.mgrid[margin:size[0] - margin:step, margin:size[1] - margin:step]
    return np.stack([u.ravel(), v.ravel()], axis=-1).astype(np.float64)
