"""Covariances of steps from a batch: against the dense inverse, and against errors over draws."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import chi2

from point_world import CAMERA, odometry, world
from slam.backend.bundle import bundle
from slam.backend.config import BundleConfig
from slam.backend.pose_covariance import step_covariances
from slam.geometry import se3


def banded(rng, F, B):
    """A positive system as upper blocks (F, B, 6, 6), and whole."""
    S, full = np.zeros((F, B, 6, 6)), np.zeros((6 * F, 6 * F))
    for k in range(F):
        for d in range(min(B, F - k)):
            block = 0.3 * rng.normal(size=(6, 6))
            S[k, d] = block if d else block @ block.T + 20.0 * np.eye(6)
            full[6 * k:6 * k + 6, 6 * (k + d):6 * (k + d) + 6] = S[k, d]
            full[6 * (k + d):6 * (k + d) + 6, 6 * k:6 * k + 6] = S[k, d].T
    return S, full


def test_they_are_those_of_the_dense_inverse():
    rng = np.random.default_rng(0)
    S, full = banded(rng, 7, 4)
    T = se3.exp(0.3 * rng.normal(size=(7, 6)))
    Z = np.zeros((42, 42))
    Z[6:, 6:] = np.linalg.inv(full[6:, 6:])                  # the first pose is held
    found = step_covariances(S, T)
    assert np.isnan(found[0]).all()
    for k in range(1, 7):
        J = np.zeros((6, 42))
        J[:, 6 * k - 6:6 * k] = -se3.adjoint(se3.inverse(T[k]) @ T[k - 1])
        J[:, 6 * k:6 * k + 6] = np.eye(6)
        assert_allclose(found[k], J @ Z @ J.T, atol=1e-12)


def test_a_singular_system_has_none():
    T = np.repeat(np.eye(4)[None], 4, axis=0)
    assert np.isnan(step_covariances(np.zeros((4, 2, 6, 6)), T)).all()


def test_errors_of_the_batch_are_as_large_as_it_says():
    """NEES of the steps over worlds whose noise is that which is assumed."""
    config = BundleConfig(kernel_width=1e3, rounds=0, iterations=20, covariances=True)
    nees = []
    for seed in range(12):
        T, xyz, s = world(seed, frames=8, landmarks=40)
        got = bundle(odometry(T, seed + 100), xyz, s, CAMERA, config)
        step = se3.inverse(got.T_body_camera[:-1]) @ got.T_body_camera[1:]
        error = se3.log(se3.inverse(step) @ se3.inverse(T[:-1]) @ T[1:])
        # Steps of one run hang together: every other one counts.
        nees += [e @ np.linalg.solve(P, e) for e, P in zip(error[::2], got.step_covariance[1::2],
                                                           strict=True)]
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * len(nees))
    assert low < np.sum(nees) < high
