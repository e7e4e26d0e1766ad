"""Points beside the border of a nearer surface show what lies behind."""

import numpy as np
import pytest

from slam.dpl.borders import behind_border, noise_of_inverse_depth
from slam.dpl.config import OrbConfig
from slam.dpl.orb import OrbDetector

SIGMA = 0.002
REACH = 3.0


def behind(depth, uv):
    uv = np.asarray(uv, np.float64).reshape(-1, 2)
    return behind_border(depth.astype(np.float32), uv, np.full(len(uv), REACH), SIGMA)


def step(near=2.0, far=4.0):
    """The near surface is left of column 30."""
    depth = np.full((60, 80), far)
    depth[:, :30] = near
    return depth


def test_the_far_side_of_a_border_is_behind_it_and_the_near_side_is_not():
    at = [[20, 30], [27, 30], [32, 30], [34, 30], [50, 30]]
    assert behind(step(), at).tolist() == [False, False, True, False, False]


def test_a_plane_has_no_border_however_steep():
    v = np.arange(60.0)[:, None] + np.zeros((1, 80))
    ground = 1.6 * 50.0 / (v + 4.0)               # from 20 m in the first row to 1.3 m
    u, v = np.meshgrid(np.arange(8, 72, 4), np.arange(8, 52, 4))
    assert not behind(ground, np.stack([u, v], -1)).any()


def test_a_slight_relief_has_a_border_where_the_depth_is_as_good_as_that():
    """A window's reveal of 0.4 m, 15 m away: within three standard deviations, of which there are
    none in this image."""
    relief = step(14.6, 15.0)
    at = [[27, 30], [32, 30], [50, 30]]
    assert behind(relief, at).tolist() == [False, True, False]
    rng = np.random.default_rng(0)
    assert not behind(1.0 / (1.0 / relief + rng.normal(0.0, SIGMA, relief.shape)), at).any()


def test_the_noise_of_inverse_depth_is_found_in_the_image():
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:240, :320]
    plane = 0.2 + 0.0005 * u + 0.0002 * v
    plane[:, 200:] += 0.3                          # a border of something nearer
    noise = rng.normal(0.0, 0.001, plane.shape)
    assert noise_of_inverse_depth(1.0 / plane) < 1e-7
    assert noise_of_inverse_depth(1.0 / (plane + noise)) == pytest.approx(0.001, rel=0.05)
    quantised = np.round((plane + noise) / 0.003) * 0.003
    assert 0.0005 < noise_of_inverse_depth(1.0 / quantised) < 0.003
    assert noise_of_inverse_depth(np.zeros((40, 60))) == np.inf


def test_noise_is_no_border():
    rng = np.random.default_rng(0)
    noisy = 1.0 / (1.0 / 3.0 + rng.normal(0.0, SIGMA, (240, 320)))
    uv = rng.uniform(10, [310, 230], (3000, 2))
    assert np.mean(behind(noisy, uv)) < 0.001


def test_a_point_beside_pixels_without_depth_or_beside_the_image_is_left_as_it_is():
    depth = step()
    depth[25:36, 30:36] = 0.0
    assert not behind(depth, [[32, 30]]).any()
    assert not behind(depth, [[0, 0], [79, 59], [-5, 100]]).any()


def test_points_behind_a_border_have_no_depth():
    rng = np.random.default_rng(1)
    gray = np.full((240, 320), 60, np.uint8)
    gray[:, :160] = np.kron(rng.integers(0, 255, (30, 20)), np.ones((8, 8)))
    gray[:, 160:] = np.kron(rng.integers(0, 255, (30, 20)), np.ones((8, 8)))
    depth = np.full((240, 320), 5.0, np.float32)
    depth[:, :160] = 2.0
    found = OrbDetector(OrbConfig(count=400))(gray, depth)
    u = found.uv_px[:, 0]
    beside = (u > 160.5) & (u < 163.0)            # nearer than any reach
    assert beside.sum() >= 3
    assert (found.depth_m[beside] == 0.0).all()
    assert (found.depth_m[(u < 158.0) | (u > 180.0)] > 0.0).all()
