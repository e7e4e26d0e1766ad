"""Colour noise against its variance formula."""

import numpy as np
import pytest

from simbench.sensors import RgbNoise, Stage, apply_rgb_noise, generator


def image(level: int) -> np.ndarray:
    return np.full((200, 200, 3), level, np.uint8)


@pytest.mark.parametrize("level", [30, 120, 220])
def test_variance_is_shot_plus_read(level):
    noisy = apply_rgb_noise(image(level), RgbNoise(full_well_e=5_000.0, read_dn=1.2),
                            generator(1, Stage.RGB, 0)).astype(np.float64)
    expected = level * 255 / 5_000.0 + 1.2**2 + 1 / 12   # and the rounding to 8 bits
    assert noisy.var() == pytest.approx(expected, rel=0.03)
    assert noisy.mean() == pytest.approx(level, abs=0.05)


def test_gain_brightens_and_saturates():
    quiet = RgbNoise(full_well_e=0.0, read_dn=0.0, gain=1.5)
    rng = generator(1, Stage.RGB, 0)
    assert (apply_rgb_noise(image(100), quiet, rng) == 150).all()
    assert (apply_rgb_noise(image(200), quiet, rng) == 255).all()


def test_noise_never_wraps_around():
    noise = RgbNoise(full_well_e=500.0, read_dn=5.0)
    assert apply_rgb_noise(image(1), noise, generator(2, Stage.RGB, 0)).max() < 100
    assert apply_rgb_noise(image(255), noise, generator(2, Stage.RGB, 0)).min() > 150


def test_without_noise_it_is_a_copy():
    rgb = image(7)
    out = apply_rgb_noise(rgb, None, generator(0, Stage.RGB, 0))
    np.testing.assert_array_equal(out, rgb)
    assert not np.shares_memory(out, rgb)
