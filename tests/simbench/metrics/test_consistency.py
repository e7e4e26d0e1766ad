"""NEES, its bounds and efficiency, where errors and covariances are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simbench.metrics.bound import motion_information
from simbench.metrics.camera import MotionErrors, camera_step_errors
from simbench.metrics.consistency import camera_nees, consistency_metrics, nees, nees_bounds
from simbench.metrics.efficiency import CAMERA as STATIC
from simbench.metrics.efficiency import Bounds, GaussianNoise, visible_pixels
from simbench.metrics.objects import object_errors
from slam.geometry import se3
from synthetic import SyntheticTruth, exact_camera, exact_motions, world

TRUTH = world(count=400, objects=1, still=0)
COVARIANCE = np.diag([1e-3, 2e-3, 1e-3, 5e-3, 3e-3, 4e-3]) ** 2


def test_a_linear_estimate_of_known_noise_lies_within_its_bounds():
    """Least squares of y = A x + n: the NEES of its covariance over draws is χ²."""
    rng = np.random.default_rng(0)
    draws, rows = 500, 20
    A = rng.normal(size=(rows, 6)) * [1, 10, 0.1, 5, 2, 1]
    error = rng.normal(size=(draws, rows)) @ np.linalg.pinv(A).T
    covariance = np.linalg.inv(A.T @ A)
    # Small enough for the tangent space to be flat.
    T = se3.exp(1e-5 * error)
    values = nees(np.broadcast_to(np.eye(4), T.shape), T,
                  np.broadcast_to(1e-10 * covariance, (draws, 6, 6)))
    low, high = nees_bounds(draws)
    assert low < values.mean() < high
    assert not low < 1.3 * values.mean() < high


@pytest.mark.parametrize("count", [1, 30, 300])
def test_the_bounds_hold_the_mean_with_their_probability(count):
    rng = np.random.default_rng(1)
    means = rng.chisquare(6, size=(4000, count)).mean(axis=1)
    low, high = nees_bounds(count)
    inside = np.mean((means > low) & (means < high))
    assert inside == pytest.approx(0.95, abs=0.015)      # four deviations of 4000 draws


def estimates(stated, seed=2):
    """Camera and motions that err by draws of COVARIANCE, with `stated` times it stated."""
    rng = np.random.default_rng(seed)
    exact = exact_camera(TRUTH)
    K = len(TRUTH.stamps_s)
    error = se3.exp(rng.normal(size=(K, 6)) @ np.sqrt(COVARIANCE))
    P = np.broadcast_to(stated * COVARIANCE, (K, 6, 6)).copy()
    P[5] = np.nan                                         # one frame states none
    camera = replace(exact, T_previous_camera=exact.T_previous_camera @ error, step_covariance=P)
    motions = exact_motions(TRUTH, exact, {1: 7})
    # An error in the camera before, carried to the world, and its covariance with it.
    X = motions.T_world_camera
    A = se3.adjoint(X)
    error = se3.exp(rng.normal(size=(len(motions), 6)) @ np.sqrt(COVARIANCE))
    motions = replace(motions, H_world=motions.H_world @ X @ error @ se3.inverse(X),
                      covariance=stated * A @ COVARIANCE @ np.swapaxes(A, 1, 2))
    return camera, motions


def block(stated):
    camera, motions = estimates(stated)
    errors = object_errors(motions, {7: 1}, camera, TRUTH, exact=True)
    return consistency_metrics(camera, camera_step_errors(camera, TRUTH), motions, errors, TRUTH)


def test_right_covariances_lie_within_the_bounds_and_wrong_ones_do_not():
    right, bold = block(1.0), block(0.25)
    for of in ("camera", "objects"):
        assert right[f"nees_{of}_low"] < right[f"nees_{of}"] < right[f"nees_{of}_high"]
        assert right[f"nees_{of}_inside"] == pytest.approx(0.95, abs=0.04)
        assert bold[f"nees_{of}"] == pytest.approx(4.0 * right[f"nees_{of}"])
        assert bold[f"nees_{of}_inside"] < 0.4


def test_what_states_no_covariance_has_no_nees():
    camera, motions = estimates(1.0)
    frame = np.arange(1, len(TRUTH.stamps_s))
    assert len(camera_nees(camera, TRUTH, frame)) == len(frame) - 1
    camera = replace(camera, step_covariance=None)
    errors = object_errors(replace(motions, covariance=None), {7: 1}, camera, TRUTH, exact=True)
    assert consistency_metrics(camera, camera_step_errors(camera, TRUTH),
                               replace(motions, covariance=None), errors, TRUTH) == {}




def test_an_estimate_at_the_bound_has_efficiency_one():
    rng = np.random.default_rng(3)
    K = 4000
    error = rng.normal(size=(K, 6)) @ np.sqrt(COVARIANCE)
    steps = MotionErrors(np.arange(K), np.linalg.norm(error[:, 3:], axis=1),
                         np.degrees(np.linalg.norm(error[:, :3], axis=1)))
    bounds = Bounds(SyntheticTruth(TRUTH), GaussianNoise(0.3, 0.002),
                    {k: {STATIC: np.linalg.inv(COVARIANCE)} for k in range(K)})
    found = bounds.efficiencies(steps, {})
    assert found == {"efficiency_camera": pytest.approx(1.0, abs=0.05),
                     "efficiency_camera_rotation": pytest.approx(1.0, abs=0.05)}
    twice = bounds.efficiencies(replace_errors(steps, 2.0), {})
    assert twice["efficiency_camera"] == pytest.approx(found["efficiency_camera"] / 4.0)


def replace_errors(steps, factor):
    return MotionErrors(steps.frame, factor * steps.t_m, factor * steps.r_deg)


def test_a_sample_of_the_pixels_tells_the_information_of_all(marker_sequence):
    noise = GaussianNoise(0.3, 0.002)
    T = se3.inverse(marker_sequence.truth.trajectories.T_world_camera[0]) @ \
        marker_sequence.truth.trajectories.T_world_camera[1]
    every = visible_pixels(marker_sequence.truth, 1, noise)[STATIC]
    some = visible_pixels(marker_sequence.truth, 1, noise, 2000)[STATIC]
    assert len(some[0].uv_a) == min(2000, len(every[0].uv_a))
    full, sampled = (each * motion_information(T, seen, marker_sequence.intrinsics)
                     for seen, each in (every, some))
    assert np.trace(np.linalg.inv(sampled)[3:, 3:]) == pytest.approx(
        np.trace(np.linalg.inv(full)[3:, 3:]), rel=0.1)
