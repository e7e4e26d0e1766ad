"""Every Jacobian against numerical differentiation, at random states."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from slam import residuals
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.types import Intrinsics

CAMERA = Intrinsics(500.0, 520.0, 319.5, 239.5, 640, 480)
seeds = st.integers(0, 2**32 - 1)


def random_state(seed, n=5):
    rng = np.random.default_rng(seed)
    T_a_b = se3.exp(rng.normal(size=6) * [0.1, 0.1, 0.1, 0.3, 0.3, 0.3])
    uv_a = rng.uniform([0, 0], [640, 480], size=(n, 2, 2))
    rho_a = 1.0 / rng.uniform(1.5, 20.0, size=(n, 2))
    uv_b = uv_a + rng.normal(size=(n, 2, 2))
    return T_a_b, pinhole.rays(CAMERA, uv_a), rho_a, uv_b, 1.0 / rng.uniform(1.5, 20.0, size=n)


def numeric(function, x, step=1e-6):
    """Central differences of function (any shape) along each element of x, last axis."""
    columns = []
    for i in range(x.size):
        d = np.zeros(x.size)
        d[i] = step
        d = d.reshape(x.shape)
        columns.append((function(x + d) - function(x - d)) / (2 * step))
    return np.stack(columns, axis=-1)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_point_terms_jacobians(seed):
    T, rays, rho, uv, rho_b = random_state(seed)
    args = (rays[:, 0], rho[:, 0], uv[:, 0], rho_b, CAMERA)
    terms = residuals.point_terms(T, *args)
    J_pose = numeric(lambda xi: residuals.point_terms(T @ se3.exp(xi), *args).r, np.zeros(6))
    assert_allclose(terms.J_pose, J_pose, rtol=1e-6, atol=2e-5)
    J_rho = numeric(lambda d: residuals.point_terms(T, rays[:, 0], rho[:, 0] + d, uv[:, 0],
                                                    rho_b, CAMERA).r, np.zeros(1))[..., 0]
    assert_allclose(terms.J_rho, J_rho, rtol=1e-6, atol=2e-4)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_point_terms_agree_with_projection(seed):
    T, rays, rho, uv, rho_b = random_state(seed)
    terms = residuals.point_terms(T, rays[:, 0], rho[:, 0], uv[:, 0], rho_b, CAMERA)
    p_b = se3.transform_points(se3.inverse(T), rays[:, 0] / rho[:, :1])
    assert_allclose(terms.r[:, :2], pinhole.project(CAMERA, p_b) - uv[:, 0], atol=1e-8)
    assert_allclose(terms.r[:, 2], 1.0 / p_b[:, 2] - rho_b, atol=1e-12)


def test_one_pose_and_a_pose_per_point_give_the_same():
    T, rays, rho, uv, rho_b = random_state(3)
    one = residuals.point_terms(T, rays[:, 0], rho[:, 0], uv[:, 0], rho_b, CAMERA)
    each = residuals.point_terms(np.repeat(T[None], 5, 0), rays[:, 0], rho[:, 0], uv[:, 0],
                                 rho_b, CAMERA)
    for a, b in zip(one, each, strict=True):
        assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("normalise", ["pixel", "paper"])
@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_line_terms_jacobians(normalise, seed):
    T, rays, rho, ends, _ = random_state(seed)
    terms = residuals.line_terms(T, rays, rho, ends, CAMERA, normalise)
    scale = 1.0 + np.abs(terms.J_pose).max()

    def at(T=T, rho=rho, ends=ends):
        return residuals.line_terms(T, rays, rho, ends, CAMERA, normalise).r

    J_pose = numeric(lambda xi: at(T=T @ se3.exp(xi)), np.zeros(6))
    assert_allclose(terms.J_pose, J_pose, atol=1e-6 * scale)
    J_flow = numeric(lambda d: at(ends=ends + d.reshape(2, 2)), np.zeros(4), 1e-4)
    assert_allclose(terms.J_flow, J_flow, rtol=1e-4, atol=1e-5 * (1 + np.abs(J_flow).max()))
    J_rho = numeric(lambda d: at(rho=rho + d), np.zeros(2))
    assert_allclose(terms.J_rho, J_rho, atol=1e-6 * (1 + np.abs(J_rho).max()))


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_both_rows_of_the_line_residual_are_distances_in_pixels(seed):
    T, rays, rho, ends, _ = random_state(seed)
    terms = residuals.line_terms(T, rays, rho, ends, CAMERA)
    uv = pinhole.project(CAMERA, se3.transform_points(se3.inverse(T), (rays / rho[..., None])
                                                      .reshape(-1, 3))).reshape(5, 2, 2)
    a, b = ends[:, 0], ends[:, 1]
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    for row in range(2):
        gap = uv[:, row] - a
        distance = np.abs(along[:, 0] * gap[:, 1] - along[:, 1] * gap[:, 0])
        assert_allclose(np.abs(terms.r[:, row]), distance, atol=1e-7)


def test_a_segment_without_length_has_no_line():
    line, _ = residuals.observed_line(np.ones((1, 2)), np.ones((1, 2)))
    assert np.isnan(line).all()
