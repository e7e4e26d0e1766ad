"""Surfaces fitted to inverse depth: exact on planes, never across labels and edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from slam.frontend.surface import fit_surfaces

SIZE = (40, 60)
ONE_LABEL = np.zeros(SIZE, np.uint8)
v, u = np.mgrid[:SIZE[0], :SIZE[1]].astype(float)


def plane(rho0=0.4, slope_u=0.0, slope_v=0.0):
    return (rho0 + slope_u * (u - 30) + slope_v * (v - 20)).astype(np.float32)


def places(seed, n=60, margin=0.0):
    high = [SIZE[1] - 1 - margin, SIZE[0] - 1 - margin]
    return np.random.default_rng(seed).uniform(margin, high, (n, 2))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_planes_are_exact_up_to_the_image_border(seed):
    rng = np.random.default_rng(seed)
    slope = rng.uniform(-2e-3, 2e-3, 2)
    uv = places(seed)
    found = fit_surfaces(plane(0.4, *slope), ONE_LABEL, uv, 0.002)
    assert_allclose(found.rho, 0.4 + (uv - [30, 20]) @ slope, rtol=2e-5)
    assert_allclose(found.slope, np.broadcast_to(slope, (len(uv), 2)), atol=2e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_the_gain_is_that_of_a_least_squares_plane(seed):
    uv = places(seed, 20, margin=4.0)
    gain = fit_surfaces(plane(), ONE_LABEL, uv, 0.002).gain
    rest = np.rint(uv) - uv
    # Σx² over 7×7 offsets about the pixel's centre is 7 · 28.
    assert_allclose(gain, np.sqrt(1 / 49 + (rest**2).sum(axis=1) / 196), rtol=0.01)


def test_the_gain_is_what_noise_does_to_the_fit():
    rng = np.random.default_rng(0)
    uv, sigma = places(1, 400, margin=4.0), 0.002
    errors = [fit_surfaces((plane(0.4, 1e-3) + sigma * rng.normal(size=SIZE)).astype(np.float32),
                           ONE_LABEL, uv, sigma) for _ in range(20)]
    truth = 0.4 + 1e-3 * (uv[:, 0] - 30)
    ratio = np.array([(e.rho - truth) / (sigma * e.gain) for e in errors])
    assert 0.95 < ratio.std() < 1.15                     # a little is lost to the trimming
    assert abs(ratio.mean()) < 0.05


def test_pixels_of_another_label_never_count():
    label = (u >= 30).astype(np.uint8)
    rho = np.where(label, 0.412, 0.400).astype(np.float32)   # 3 %: depth alone would not tell
    uv = places(2, 300)
    found = fit_surfaces(rho, label, uv, 0.002)
    own = np.where(np.rint(uv[:, 0]) >= 30, 0.412, 0.400)
    has = found.rho > 0
    assert has.mean() > 0.98
    assert_allclose(found.rho[has], own[has], rtol=1e-5)


def test_depth_edges_are_never_blended():
    rho = np.where(u >= 30, 0.5, 0.25).astype(np.float32)
    uv = places(3, 300)
    found = fit_surfaces(rho, ONE_LABEL, uv, 0.002)
    assert_allclose(found.rho, np.where(np.floor(uv[:, 0] + 0.5) >= 30, 0.5, 0.25), rtol=1e-5)
    assert_allclose(found.slope, 0.0, atol=1e-6)


def test_a_bent_surface_is_fitted_where_it_is_smooth():
    rho = (0.4 + 1.5e-3 * np.abs(u - 30)).astype(np.float32)   # a room's corner
    uv = np.array([[20.0, 20.0], [25.9, 20.0], [40.0, 20.0]])
    found = fit_surfaces(rho, ONE_LABEL, uv, 1e-5)
    assert_allclose(found.slope[:, 0], [-1.5e-3, -1.5e-3, 1.5e-3], rtol=1e-3)


@pytest.mark.parametrize("where", [[-5.0, 5.0], [5.0, 40.0], [np.nan, 5.0], [np.inf, 5.0]])
def test_outside_the_image_there_is_no_surface(where):
    found = fit_surfaces(plane(), ONE_LABEL, np.array([where]), 0.002)
    assert_array_equal(found.rho, 0.0)
    assert_array_equal(found.gain, 1.0)


def test_without_depth_or_with_too_little_of_it_there_is_no_surface():
    rho = np.zeros(SIZE, np.float32)
    rho[20, 30] = rho[20, 31] = 0.4
    found = fit_surfaces(rho, ONE_LABEL, np.array([[30.0, 20.0], [10.0, 10.0]]), 0.002)
    assert_array_equal(found.rho, 0.0)


def test_holes_are_left_out_of_the_fit():
    rng = np.random.default_rng(5)
    whole = plane(0.4, 1e-3, -5e-4)
    rho = np.where(rng.random(SIZE) < 0.4, 0.0, whole).astype(np.float32)
    uv = np.stack([u[rho > 0], v[rho > 0]], axis=1)
    found = fit_surfaces(rho, ONE_LABEL, uv, 0.002)
    has = found.rho > 0
    assert has.mean() > 0.95
    assert_allclose(found.rho[has], whole[rho > 0][has], rtol=1e-4)
