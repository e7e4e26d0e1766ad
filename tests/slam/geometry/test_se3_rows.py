"""The compiled rows are the array functions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.factors import odometry_terms
from slam.geometry import se3, se3_rows


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 2e-4, 0.01, 1.0, 3.0, np.pi - 1e-6, np.pi])
def test_exp_and_log_agree_with_the_array_functions(angle):
    rng = np.random.default_rng(0)
    T, xi, R, w = np.empty((4, 4)), np.empty(6), np.empty((3, 3)), np.empty(3)
    for _ in range(20):
        axis = rng.normal(size=3)
        vector = np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(size=3)])
        se3_rows.exp_row(vector, T)
        assert_allclose(T, se3.exp(vector), atol=1e-13)
        se3_rows.log_row(T, xi)
        assert_allclose(se3.exp(xi), T, atol=1e-12)
        assert np.linalg.norm(xi[:3]) <= np.pi + 1e-12
        se3_rows.exp_so3_row(vector[:3], R)
        assert_allclose(R, T[:3, :3], atol=1e-15)
        se3_rows.log_so3_row(R, w)
        assert_allclose(w, xi[:3], atol=1e-15)


def test_moved_and_between_agree_with_the_array_functions():
    rng = np.random.default_rng(1)
    A, xi = se3.exp(rng.normal(size=(5, 6))), rng.normal(size=(5, 6))
    B, out = se3_rows.moved_rows(A, xi), np.empty((4, 4))
    assert_allclose(B, A @ se3.exp(xi), atol=1e-13)
    for a, b, step in zip(A, B, xi, strict=True):
        se3_rows.between_row(a, b, out)
        assert_allclose(out, se3.exp(step), atol=1e-13)
    assert_allclose(odometry_terms(A, B, se3.exp(xi)).r, 0.0, atol=1e-12)
