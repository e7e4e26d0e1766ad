"""What depths of one part of an image err by together, beside noise of each."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.estimation.depth_parts import common_depth_error
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.matches import PointMatches
from slam.types import Intrinsics

CAMERA = Intrinsics(640, 480, 500.0, 500.0, 320.0, 240.0)
T_A_B = se3.exp(np.array([0.01, -0.02, 0.005, 0.1, 0.02, 0.3]))


def world(rng, noise, common, points=6000, depth_in_b=True):
    """Static points whose second inverse depths have noise of their own and of 80 × 120 px."""
    uv = rng.uniform([0, 0], [640, 480], (points, 2))
    rho = rng.uniform(0.02, 0.2, points)
    xyz_b = se3.transform_points(se3.inverse(T_A_B),
                                 pinhole.back_project(CAMERA, uv, 1.0 / rho))
    of_part = rng.normal(0.0, common, (4, 8))
    rho_b = (1.0 / xyz_b[:, 2] + rng.normal(0.0, noise, points)
             + of_part[(uv[:, 1] // 120).astype(int), (uv[:, 0] // 80).astype(int)])
    sigma = np.full(points, noise)
    return PointMatches(uv, rho, sigma, pinhole.project(CAMERA, xyz_b),
                        np.tile(np.eye(2), (points, 1, 1)), rho_b,
                        sigma if depth_in_b else np.full(points, np.inf), np.zeros((points, 2)),
                        np.zeros(points, np.int64), np.zeros(points, np.int64))


def test_noise_of_each_pixel_is_not_taken_for_a_common_one():
    rng = np.random.default_rng(0)
    found = [common_depth_error(world(rng, 1e-3, 0.0), T_A_B, CAMERA) for _ in range(20)]
    assert np.median(found) < 5e-5


@pytest.mark.parametrize("common", [3e-4, 2e-3])
def test_what_parts_err_by_is_found(common):
    rng = np.random.default_rng(1)
    found = [common_depth_error(world(rng, 3e-4, common), T_A_B, CAMERA) for _ in range(20)]
    assert_allclose(np.median(found), common, rtol=0.25)


def test_without_depth_nothing_is_known():
    rng = np.random.default_rng(2)
    assert np.isnan(common_depth_error(world(rng, 1e-3, 0.0, depth_in_b=False), T_A_B, CAMERA))
    assert np.isnan(common_depth_error(world(rng, 1e-3, 0.0, points=50), T_A_B, CAMERA))
