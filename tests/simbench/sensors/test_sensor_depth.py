"""Depth noise: statistics against each model's formula, holes where they belong."""

from math import erf

import numpy as np
import pytest

from simbench.sensors import (
    GaussianDepth,
    KinectDepth,
    Stage,
    StereoDepth,
    apply_depth_noise,
    clean_depth,
    depth_sigma,
    generator,
)
from simbench.sensors.surface import depth_borders, incidence_angle, second_view_shadow
from slam.types import Intrinsics

CAMERA = Intrinsics(500.0, 480.0, 159.5, 119.5, 320, 240)
MODELS = (GaussianDepth(), KinectDepth(), StereoDepth())


def wall(depth_m: float) -> np.ndarray:
    return np.full((240, 320), depth_m, np.float32)


def slanted_plane(angle_deg: float, depth_m: float = 3.0) -> np.ndarray:
    """A plane whose normal is turned about the vertical from the optical axis."""
    n = np.array([np.sin(np.deg2rad(angle_deg)), 0.0, np.cos(np.deg2rad(angle_deg))])
    u = (np.arange(320) - CAMERA.cx) / CAMERA.fx
    z = n[2] * depth_m / (n[0] * u + n[2])
    z = np.where((z > 0) & (z < 100), z, 0)      # the rest is behind the camera or far away
    return np.broadcast_to(z, (240, 320)).astype(np.float32)


def rng(frame: int = 0) -> np.random.Generator:
    return generator(7, Stage.DEPTH, frame)


@pytest.mark.parametrize("depth_m", [0.7, 2.0, 6.0])
def test_gaussian_noise_has_the_sigma_of_its_formula(depth_m):
    noisy = apply_depth_noise(wall(depth_m), CAMERA, GaussianDepth(), rng())
    assert noisy.std() == pytest.approx(0.002 * depth_m**2, rel=0.02)
    assert noisy.mean() == pytest.approx(depth_m, abs=4 * 0.002 * depth_m**2 / 277)


@pytest.mark.parametrize("depth_m", [1.0, 2.5, 4.0])
def test_kinect_axial_noise_follows_nguyen(depth_m):
    noisy = apply_depth_noise(wall(depth_m), CAMERA, KinectDepth(), rng())
    error = noisy[noisy > 0] - depth_m
    assert error.std() == pytest.approx(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, rel=0.05)


def test_kinect_depth_comes_in_steps_of_disparity():
    model = KinectDepth(quantum_m=0.0)
    levels = np.unique(apply_depth_noise(wall(5.0), CAMERA, model, rng()))
    levels = levels[levels > 0]
    steps = np.diff(1.0 / levels.astype(np.float64)) / 0.00285
    np.testing.assert_allclose(steps, np.rint(steps), atol=2e-2)
    assert np.diff(levels).min() == pytest.approx(0.00285 * 25, rel=0.1)


def test_kinect_lateral_noise_moves_a_border_by_its_pixels():
    """On a step edge the share of pixels read from the far side is the normal's tail."""
    depth = wall(2.0)
    depth[:, 160:] = 2.2
    model = KinectDepth(border_holes=0.0, baseline_m=0.0)
    columns = []
    for frame in range(20):
        noisy = apply_depth_noise(depth, CAMERA, model, rng(frame))
        columns.append((noisy > 2.1).mean(axis=0))
    share = np.mean(columns, axis=0)
    # A pixel d columns before the border crosses it when its shift, rounded, is at least d.
    for column, needed in ((159, 0.5), (158, 1.5)):
        expected = 0.5 * (1 - erf(needed / 0.8 / np.sqrt(2)))
        assert share[column] == pytest.approx(expected, abs=0.015)
    assert share[150] == 0.0
    assert share[170] == 1.0


@pytest.mark.parametrize("depth_m", [1.0, 3.0, 6.0])
def test_stereo_noise_has_the_sigma_of_its_formula(depth_m):
    errors = np.concatenate([
        (d := apply_depth_noise(wall(depth_m), CAMERA, StereoDepth(), rng(frame)))[d > 0] - depth_m
        for frame in range(3)])
    assert errors.std() == pytest.approx(depth_m**2 * 0.08 / (500.0 * 0.05), rel=0.06)


def test_stereo_noise_is_smooth_over_the_matching_window():
    noisy = apply_depth_noise(wall(3.0), CAMERA, StereoDepth(), rng())
    error = noisy[:, 40:] - 3.0     # the left strip is the second camera's shadow
    neighbours = np.mean(error[:, 1:] * error[:, :-1]) / np.mean(error**2)
    far = np.mean(error[:, 20:] * error[:, :-20]) / np.mean(error**2)
    assert neighbours > 0.7
    assert abs(far) < 0.1


@pytest.mark.parametrize("model", MODELS)
def test_sigma_is_what_the_noise_has(model):
    depth = wall(2.0)
    error = [(d := apply_depth_noise(depth, CAMERA, model, rng(f)))[d > 0] - 2.0 for f in range(3)]
    sigma = depth_sigma(depth, CAMERA, model)
    assert np.concatenate(error).std() == pytest.approx(sigma[120, 160], rel=0.06)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0, 75.0])
def test_incidence_angle_of_a_plane(angle_deg):
    depth = slanted_plane(angle_deg)
    angle = np.rad2deg(incidence_angle(depth, CAMERA))
    u = (np.arange(320) - CAMERA.cx) / CAMERA.fx
    v = (np.arange(240)[:, None] - CAMERA.cy) / CAMERA.fy
    n = np.array([np.sin(np.deg2rad(angle_deg)), 0.0, np.cos(np.deg2rad(angle_deg))])
    true = np.rad2deg(np.arccos(np.abs(n[0] * u + n[2]) / np.sqrt(u**2 + v**2 + 1)))
    np.testing.assert_allclose(angle[depth > 0], true[depth > 0], atol=0.3)
    assert not angle[depth == 0].any()


def test_a_border_is_not_taken_for_a_slope():
    depth = wall(4.0)
    depth[:, 100:200] = 2.0
    assert np.rad2deg(incidence_angle(depth, CAMERA)).max() < 25.0


def test_shadow_is_as_wide_as_the_difference_of_disparities():
    depth = wall(4.0)
    depth[:, 150:220] = 1.0
    shadow = second_view_shadow(depth, focal_px=500.0, baseline_m=0.075)
    width = 500.0 * 0.075 * (1.0 / 1.0 - 1.0 / 4.0)
    assert shadow[100].sum() == pytest.approx(width, abs=1.5)   # half a pixel is tolerated
    assert np.flatnonzero(shadow[100]).max() == 149


@pytest.mark.parametrize("angle_deg", [50.0, 75.0])
def test_a_slanted_plane_casts_no_shadow_on_itself(angle_deg):
    depth = slanted_plane(angle_deg)
    depth = np.where((depth > 0.3) & (depth < 8.0), depth, 0).astype(np.float32)
    assert not second_view_shadow(depth, 500.0, 0.075).any()


@pytest.mark.parametrize("model", [KinectDepth(), StereoDepth()])
def test_holes_stand_at_borders_and_grazing_angles_only(model):
    depth = wall(4.0)
    depth[60:180, 150:220] = 1.5
    holes = apply_depth_noise(depth, CAMERA, model, rng()) == 0
    expected = depth_borders(depth, 0.05) | second_view_shadow(depth, 500.0, model.baseline_m)
    assert holes.any()
    assert not (holes & ~expected).any()
    steep = slanted_plane(86.0)
    assert np.mean(apply_depth_noise(steep, CAMERA, model, rng()) == 0) > 0.5


@pytest.mark.parametrize("model", [KinectDepth(), StereoDepth()])
def test_range_and_sixteen_bits(model):
    for depth_m in (0.1, model.max_m * 1.3):
        assert not apply_depth_noise(wall(depth_m), CAMERA, model, rng()).any()
    noisy = apply_depth_noise(wall(2.0), CAMERA, model, rng()).astype(np.float64)
    np.testing.assert_allclose(noisy * 1000, np.rint(noisy * 1000), atol=1e-3)


@pytest.mark.parametrize("model", [None, *MODELS])
def test_no_surface_stays_no_depth_and_truth_stays_as_it_is(model):
    depth = wall(2.0)
    depth[50:60] = 0.0
    before = depth.copy()
    depth.flags.writeable = False
    noisy = apply_depth_noise(depth, CAMERA, model, rng())
    assert not noisy[50:60].any()
    assert noisy.dtype == np.float32
    assert noisy.flags.writeable
    np.testing.assert_array_equal(depth, before)


@pytest.mark.parametrize("model", MODELS)
def test_equal_seeds_give_equal_bytes(model):
    first, again, other = (apply_depth_noise(wall(2.0), CAMERA, model, rng(f)) for f in (3, 3, 4))
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()


def test_depth_that_is_none_becomes_zero():
    dirty = np.array([[np.nan, np.inf, -np.inf, -1.0, 0.0, 2.5]], np.float32)
    np.testing.assert_array_equal(clean_depth(dirty), [[0, 0, 0, 0, 0, 2.5]])
