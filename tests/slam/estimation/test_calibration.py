"""A common offset of all inverse depths is found, and only believed once it stands out."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.config import MotionConfig
from slam.estimation.calibration import DepthOffset
from slam.estimation.motion import NoiseScales, refine_motions
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.matches import PointMatches, no_lines
from slam.types import Intrinsics

CAMERA = Intrinsics(720.0, 720.0, 620.5, 187.0, 1242, 375)
SIGMA = 0.0005


def street_matches(rng, T_a_b, offset, n=2000):
    """Points from 5 to 60 m, whose depth is measured with an offset of 1/z."""
    uv = rng.uniform([0, 0], [1242, 375], (n, 2))
    rho = 1.0 / rng.uniform(5.0, 60.0, n)
    seen_b = se3.transform_points(se3.inverse(T_a_b), pinhole.back_project(CAMERA, uv, 1.0 / rho))
    noise = rng.normal(size=(4, n))
    uv_b = pinhole.project(CAMERA, seen_b) + 0.1 * noise[:2].T
    sigma = np.full(n, SIGMA)
    return PointMatches(
        uv, rho - offset + SIGMA * noise[2], sigma, uv_b, np.tile(np.eye(2) * 0.01, (n, 1, 1)),
        1.0 / seen_b[:, 2] - offset + SIGMA * noise[3], sigma, np.zeros((n, 2)),
        np.zeros(n, int), np.zeros(n, int))


@pytest.mark.parametrize("offset", [0.0, 0.0016, -0.001])
def test_the_offset_is_told_from_the_length_of_the_step(offset):
    rng = np.random.default_rng(5)
    T_a_b = se3.exp(np.array([0.001, 0.004, 0.0, 0.0, 0.0, 1.2]))
    matches = street_matches(rng, T_a_b, offset)
    scales = NoiseScales(np.ones(1))
    solution = refine_motions(T_a_b[None], matches, no_lines(), CAMERA, MotionConfig(), scales)
    found, sigma = solution.depth_offset
    assert abs(found - offset) < 4.0 * sigma + 0.05 * abs(offset)
    assert sigma < 2e-4
    mended = replace(matches, rho_a=matches.rho_a + found, rho_b=matches.rho_b + found)
    after = refine_motions(T_a_b[None], mended, no_lines(), CAMERA, MotionConfig(), scales)
    assert_allclose(after.T_a_b[0, 2, 3], 1.2, atol=0.01)


def test_an_offset_that_does_not_stand_out_is_not_believed():
    assert DepthOffset().value == 0.0
    assert DepthOffset().observed(0.002, 0.001).value == 0.0
    assert DepthOffset().observed(0.002, np.inf).value == 0.0
    assert DepthOffset().observed(0.0001, 1e-6).value == 0.0      # too small to matter
    assert DepthOffset().observed(0.5, 1e-6).value == 0.0         # too large to be one
    believed = DepthOffset().observed(0.0016, 0.0001).observed(0.0014, 0.0001)
    assert_allclose(believed.value, 0.0015)
