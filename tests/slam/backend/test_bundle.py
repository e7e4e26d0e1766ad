"""Bundle adjustment of one body, on worlds whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from point_world import CAMERA, RHO_SIGMA, UV_SIGMA, odometry, position_rms, world
from slam.backend import reduced
from slam.backend.bundle import BodyPath, bundle
from slam.backend.config import BundleConfig
from slam.backend.linearise import linearise
from slam.factors import landmark_terms
from slam.geometry import se3
from slam.residuals import camera_tuple
from slam.tables import taken


def test_the_batch_takes_drift_away():
    ratios = []
    for seed in range(3):
        T, xyz, s = world(seed)
        path = odometry(T, seed)
        got = bundle(path, xyz + 0.05, s, CAMERA, BundleConfig())
        assert got.objective < got.objective_before
        ratios.append(position_rms(got.T_body_camera, T) / position_rms(path.T_body_camera, T))
    assert np.mean(ratios) < 0.4


def test_without_noise_the_truth_comes_back():
    T, xyz, s = world(noise=0.0)
    path = odometry(T, 1)
    path = replace(path, information=path.information * 1e-6)
    got = bundle(path, xyz + 0.02, s, CAMERA, BundleConfig(iterations=30, tolerance=1e-14))
    assert_allclose(got.T_body_camera, T, atol=1e-6)
    assert_allclose(got.xyz_body, xyz, atol=1e-4)


def test_noise_is_measured():
    T, xyz, s = world(4, frames=20, landmarks=150)
    claimed = replace(s, covariance=s.covariance * 4.0, rho_sigma=s.rho_sigma * 0.5)
    got = bundle(odometry(T, 4), xyz, claimed, CAMERA, BundleConfig())
    assert got.uv_scale == pytest.approx(0.5, rel=0.1)
    assert got.rho_scale == pytest.approx(2.0, rel=0.1)


def test_a_tenth_of_wrong_sightings_does_little_harm():
    T, xyz, s = world(2)
    rng = np.random.default_rng(2)
    wrong = rng.random(len(s)) < 0.1
    bad = replace(s, uv_px=s.uv_px + np.where(wrong[:, None], rng.uniform(-30, 30, (len(s), 2)), 0))
    path = odometry(T, 2)
    clean = position_rms(bundle(path, xyz, s, CAMERA, BundleConfig()).T_body_camera, T)
    spoilt = position_rms(bundle(path, xyz, bad, CAMERA, BundleConfig()).T_body_camera, T)
    assert spoilt < 1.5 * clean + 1e-4


@given(st.integers(0, 10_000), st.sampled_from(["none", "one", "parallel", "behind", "gap",
                                                "singular"]))
@settings(max_examples=15, deadline=None)
def test_never_worse_and_never_nan(seed, case):
    T, xyz, s = world(seed % 5, frames=6, landmarks=12)
    path = odometry(T, seed)
    rng = np.random.default_rng(seed)
    if case == "none":                       # no sighting at all
        xyz, s = np.zeros((0, 3)), taken(s, np.zeros(0, np.int64))
    elif case == "one":                      # two points on the body, one sighting each
        keep = np.array([np.flatnonzero(s.landmark == 0)[0], np.flatnonzero(s.landmark == 1)[-1]])
        xyz, s = xyz[:2], taken(s, keep)
    elif case == "parallel":                 # all landmarks at one place
        s = replace(s, uv_px=np.tile([[320.0, 240.0]], (len(s), 1)))
    elif case == "behind":                   # a path that turned away from what was seen
        turned = se3.exp(np.array([0.0, np.pi * rng.uniform(0.5, 1.0), 0, 0, 0, 0]))
        path = replace(path, T_body_camera=path.T_body_camera @ turned)
    elif case == "gap":                      # frames without a sighting, steps of unknown worth
        s = taken(s, ((s.frame < 2) | (s.frame > 3)) & (s.landmark < 11))   # and one lost all
        path = replace(path, information=path.information * 0.0)
    elif case == "singular":                 # no depth, no parallax
        s = replace(s, rho_sigma=np.full(len(s), np.inf))
        path = BodyPath(np.repeat(np.eye(4)[None], 6, 0), np.repeat(np.eye(4)[None], 6, 0),
                        np.zeros((6, 6, 6)))
    got = bundle(path, xyz, s, CAMERA, BundleConfig())
    assert got.objective <= got.objective_before
    assert np.isfinite(got.T_body_camera).all()
    assert np.isfinite(got.xyz_body).all()
    assert_allclose(got.T_body_camera[0], path.T_body_camera[0], atol=1e-12)


def test_runs_are_bit_equal():
    T, xyz, s = world(7)
    first = bundle(odometry(T, 7), xyz, s, CAMERA, BundleConfig())
    second = bundle(odometry(T, 7), xyz, s, CAMERA, BundleConfig())
    assert first.T_body_camera.tobytes() == second.T_body_camera.tobytes()


def test_reduced_system_is_the_schur_complement():
    T, xyz, s = world(3, frames=4, landmarks=7)
    s = taken(s, np.random.default_rng(0).random(len(s)) < 0.8)
    M, F, P = len(s), 4, 7
    start = np.searchsorted(s.landmark, np.arange(P + 1))
    terms = landmark_terms(T[s.frame], xyz[s.landmark], s.uv_px, s.rho, CAMERA)
    whitening = np.tile([1 / UV_SIGMA, 0.0, 1 / UV_SIGMA, 1 / RHO_SIGMA], (M, 1))
    r, J, V = np.zeros((M, 3)), np.zeros((M, 3, 6)), np.zeros((M, 3, 3))
    cost, _ = linearise(T, xyz, s.frame, s.landmark, s.uv_px, s.rho, whitening,
                        camera_tuple(CAMERA), 1e9, r, J, V)     # so wide: quadratic
    L = np.diag([1 / UV_SIGMA, 1 / UV_SIGMA, 1 / RHO_SIGMA])
    assert cost == pytest.approx(np.sum((terms.r @ L) ** 2), rel=1e-6)
    full = np.zeros((3 * M, 6 * F + 3 * P))
    for i in range(M):
        full[3 * i:3 * i + 3, 6 * s.frame[i]:6 * s.frame[i] + 6] = L @ terms.J_pose[i]
        at = 6 * F + 3 * s.landmark[i]
        full[3 * i:3 * i + 3, at:at + 3] = L @ terms.J_point[i]
    H, b = full.T @ full, full.T @ (terms.r @ L).reshape(-1)
    half = np.random.default_rng(2).normal(size=(P, 3, 3)) * 50.0     # and what is held besides
    known, pull = half @ np.swapaxes(half, 1, 2), np.random.default_rng(3).normal(size=(P, 3))
    for p in range(P):
        H[6 * F + 3 * p:6 * F + 3 * p + 3, 6 * F + 3 * p:6 * F + 3 * p + 3] += known[p]
    b[6 * F:] += pull.reshape(-1)
    pp, pl, ll = H[:6 * F, :6 * F], H[:6 * F, 6 * F:], H[6 * F:, 6 * F:]
    expected = pp - pl @ np.linalg.solve(ll, pl.T)
    expected_g = b[:6 * F] - pl @ np.linalg.solve(ll, b[6 * F:])
    S, g = np.zeros((F, F, 6, 6)), np.zeros((F, 6))
    inverse, gradient = np.zeros((P, 3, 3)), np.zeros((P, 3))
    reduced.reduce_landmarks(s.frame, start, r, J, V, known, pull, 0.0, S, g, inverse, gradient)
    scale = np.abs(expected).max()
    for k in range(F):
        for d in range(F - k):
            block = expected[6 * k:6 * k + 6, 6 * (k + d):6 * (k + d) + 6]
            assert_allclose(S[k, d] if d else (S[k, d] + S[k, d].T) / 2, block, atol=1e-8 * scale)
    assert_allclose(g.reshape(-1), expected_g, atol=1e-8 * np.abs(expected_g).max() + 1e-4)
    # A step of the poses gives the landmarks the step that the full system gives them.
    step = np.random.default_rng(1).normal(size=(F, 6)) * 1e-3
    moved = reduced.landmark_steps(s.frame, start, J, V, inverse, gradient, step)
    wanted = -np.linalg.solve(ll, b[6 * F:] + pl.T @ step.reshape(-1))
    assert_allclose(moved.reshape(-1), wanted, rtol=1e-6, atol=1e-9)
