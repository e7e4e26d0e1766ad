"""Steps whose errors hang together: information, cost and derivatives against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from slam.backend.step_errors import (
    MOST_CORRELATION,
    add_steps,
    cost_of_steps,
    roots,
    ties,
)

SEEDS = st.integers(0, 2**32 - 1)


def dense_ties(known: np.ndarray, correlation: float) -> np.ndarray:
    n = len(known)
    both = known[:, None] & known[None]
    return np.linalg.inv(np.eye(n) + correlation * both * (np.eye(n, k=1) + np.eye(n, k=-1)))


@given(SEEDS, st.integers(1, 12), st.floats(-MOST_CORRELATION, MOST_CORRELATION))
def test_ties_are_the_bands_of_the_inverse(seed, n, correlation):
    known = np.random.default_rng(seed).random(n) > 0.2
    dense = dense_ties(known, correlation)
    bands = ties(known, correlation)
    for k in range(n):
        reach = min(bands.shape[1], n - k)
        assert_allclose(bands[k, :reach], dense[k, k:k + reach], rtol=1e-9, atol=1e-12)
        assert np.abs(dense[k, k + reach:]).max(initial=0.0) < 0.01


def test_independent_steps_are_tied_to_themselves_alone():
    assert_allclose(ties(np.ones(5, bool), 0.0), np.ones((5, 1)))


def test_opposite_errors_make_a_long_way_worth_more():
    n = 200
    t = ties(np.ones(n, bool), -0.4)
    along = sum((1.0 if d == 0 else 2.0) * t[:n - d, d].sum() for d in range(t.shape[1]))
    assert along / n == pytest.approx(1.0 / (1.0 - 0.8), rel=0.03)


@given(SEEDS, st.integers(1, 6), st.floats(-MOST_CORRELATION, MOST_CORRELATION))
def test_the_system_is_that_of_dense_algebra(seed, n, correlation):
    rng = np.random.default_rng(seed)
    r, first, second = rng.normal(size=(n, 6)), *rng.normal(size=(2, n, 6, 6))
    half = rng.normal(size=(n, 6, 6))
    information, known = half @ np.swapaxes(half, 1, 2), rng.random(n) > 0.2
    root, tie = roots(information), ties(known, correlation)
    J, R, whole = np.zeros((6 * n, 6 * n + 6)), np.zeros((6 * n, 6 * n)), np.zeros((n, n))
    for k in range(n):
        J[6 * k:6 * k + 6, 6 * k:6 * k + 6], J[6 * k:6 * k + 6, 6 * k + 6:6 * k + 12] = (
            first[k], second[k])
        R[6 * k:6 * k + 6, 6 * k:6 * k + 6] = root[k]
        for d in range(min(tie.shape[1], n - k)):
            whole[k, k + d] = whole[k + d, k] = tie[k, d]
    weight = R @ np.kron(whole, np.eye(6)) @ R
    H, gradient = J.T @ weight @ J, J.T @ weight @ r.reshape(-1)
    S, g = np.zeros((n + 1, n + 2, 6, 6)), np.zeros((n + 1, 6))
    add_steps(r, first, second, root, tie, S, g)
    assert_allclose(cost_of_steps(r, root, tie), r.reshape(-1) @ weight @ r.reshape(-1), rtol=1e-9)
    assert_allclose(g.reshape(-1), gradient, atol=1e-9 * np.abs(gradient).max())
    for k in range(n + 1):
        for d in range(n + 1 - k):
            assert_allclose(S[k, d], H[6 * k:6 * k + 6, 6 * (k + d):6 * (k + d) + 6],
                            atol=1e-9 * np.abs(H).max())
