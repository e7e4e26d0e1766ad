"""How alike a landmark's sightings err is read off residuals, and lowers what they count for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from point_world import CAMERA, UV_SIGMA, odometry, position_rms, world
from slam.backend.bundle import Problem, State, bundle, no_prior
from slam.backend.config import BundleConfig
from slam.backend.settle import likeness
from slam.geometry.arrays import Array

SIGHTINGS = 20


def residuals(slow: float, rng: np.random.Generator, landmarks: int = 400) -> tuple[Array, Array]:
    """Of landmarks whose places have taken up the mean: of variance 1, `slow` of it an error that
    changes its sign half way through a landmark's life."""
    half = np.where(np.arange(SIGHTINGS) < SIGHTINGS // 2, 1.0, -1.0)[None, :, None]
    r = (np.sqrt(1.0 - slow) * rng.normal(size=(landmarks, SIGHTINGS, 3))
         + np.sqrt(slow) * half * rng.normal(size=(landmarks, 1, 3)))
    r -= r.mean(axis=1, keepdims=True)
    return np.arange(0, landmarks * SIGHTINGS + 1, SIGHTINGS), r.reshape(-1, 3)


@given(st.integers(0, 2**32 - 1))
def test_independent_errors_are_not_alike(seed):
    assert likeness(*residuals(0.0, np.random.default_rng(seed))) == pytest.approx(0.0, abs=0.02)


def test_slow_errors_are_alike():
    rng = np.random.default_rng(0)
    found = [likeness(*residuals(slow, rng)) for slow in (0.1, 0.3, 0.6)]
    assert found == sorted(found)
    assert 0.03 < found[0] < 0.1 < found[1] < 0.3 < found[2]


def test_few_sightings_tell_nothing():
    start, r = residuals(0.5, np.random.default_rng(0), landmarks=1)
    assert likeness(start[:1], r[:0]) == 0.0


def test_shares_scale_the_whole_problem_but_for_the_steps():
    T, xyz, s = world(3)
    config = BundleConfig(kernel_width=1e6)
    path = odometry(T, 3)
    problem = Problem(path, s, no_prior(len(xyz)), CAMERA, config)
    state = State(T, xyz)
    whole, steps = problem.linearise(state), problem.objective(State(path.T_body_camera, xyz))
    S, g = problem.reduced(0.0)
    problem.points._share = np.full(len(s), 0.25)
    shared = problem.linearise(state)
    S_shared, g_shared = problem.reduced(0.0)
    problem.points._share = np.full(len(s), 1e-12)
    without = problem.linearise(state)
    S_steps, g_steps = problem.reduced(0.0)
    assert steps > 0
    assert_allclose(shared - without, 0.25 * (whole - without), rtol=1e-6)
    assert_allclose(g_shared - g_steps, 0.25 * (g - g_steps), atol=1e-6 * np.abs(g).max())
    assert_allclose(S_shared - S_steps, 0.25 * (S - S_steps), atol=1e-6 * np.abs(S).max())


def test_where_sightings_err_alike_steps_are_believed_more():
    """Each landmark strays slowly: in the mean over worlds, shares are better than none."""
    gained = []
    for seed in range(6):
        T, xyz, s = world(seed, frames=30, landmarks=40)
        rng = np.random.default_rng(seed)
        slow = np.sin(0.25 * s.frame + rng.uniform(0, 2 * np.pi, len(xyz))[s.landmark])
        side = rng.normal(size=(len(xyz), 2))[s.landmark] * 4.0 * UV_SIGMA
        strayed = replace(s, uv_px=s.uv_px + slow[:, None] * side)
        path = odometry(T, seed, sigma=(5e-5, 2.5e-4))
        config = BundleConfig()
        got = bundle(path, xyz, strayed, CAMERA, config)
        problem = Problem(path, strayed, no_prior(len(xyz)), CAMERA, config)
        problem.linearise(State(got.T_body_camera, got.xyz_body))
        problem.measure_likeness()
        assert problem.points._share is not None
        assert problem.points._share.min() < 0.3
        gained.append(position_rms(got.T_body_camera, T)
                      / position_rms(path.T_body_camera, T))
    assert np.exp(np.mean(np.log(gained))) < 1.0
