"""Lookups at sub-pixel positions."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from slam.frontend.sampling import bilinear, depth_at, inside, nearest


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5), st.floats(0, 19), st.floats(0, 9))
def test_bilinear_is_exact_on_ramps(a, b, c, u, v):
    columns, rows = np.meshgrid(np.arange(20.0), np.arange(10.0))
    image = a + b * columns + c * rows
    uv = np.array([[u, v]])
    assert_allclose(bilinear(image, uv), [a + b * u + c * v], atol=1e-9)
    assert_allclose(bilinear(np.dstack([image, -image]), uv),
                    [[a + b * u + c * v, -(a + b * u + c * v)]], atol=1e-9)


def test_bilinear_repeats_the_border_and_survives_nan():
    image = np.arange(12.0).reshape(3, 4)
    uv = np.array([[-3.0, 1.0], [3.0, 2.0], [99.0, 99.0], [np.nan, 0.0]])
    assert_allclose(bilinear(image, uv), [4.0, 11.0, 11.0, 0.0])


def test_nearest_and_inside():
    image = np.arange(12).reshape(3, 4)
    uv = np.array([[0.6, 0.4], [2.4, 1.6], [-1.0, 0.0]])
    assert_allclose(nearest(image, uv), [1, 10, 0])
    assert inside(uv, image.shape).tolist() == [True, True, False]
    assert inside(uv, image.shape, 0.5).tolist() == [False, False, False]


@given(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(1, 18), st.floats(1, 13))
def test_depth_is_exact_on_planes(a, b, u, v):
    columns, rows = np.meshgrid(np.arange(20.0), np.arange(15.0))
    depth = 1.0 / (0.5 + 0.5 * (a * columns + b * rows))
    assert_allclose(depth_at(depth, np.array([[u, v]])), [1.0 / (0.5 + 0.5 * (a * u + b * v))],
                    rtol=1e-9)


@given(st.floats(0, 9), st.floats(0, 5))
def test_depth_never_lies_between_two_surfaces(u, v):
    depth = np.where(np.arange(10) < 5, 2.0, 4.0) * np.ones((6, 1))
    depth[2, 3] = 0.0
    depth[4, 7] = np.nan
    found = depth_at(depth, np.array([[u, v]]))[0]
    assert np.min(np.abs(found - [0.0, 2.0, 4.0])) < 1e-12


def test_depth_is_unknown_in_holes_and_outside():
    depth = np.full((6, 8), 3.0, np.float32)
    depth[2, 3] = 0.0
    uv = np.array([[3.2, 2.2], [3.6, 2.2], [-0.1, 2.0], [7.0, 5.0], [np.nan, 1.0]])
    assert_allclose(depth_at(depth, uv), [0.0, 3.0, 0.0, 3.0, 0.0])
