"""Slow motions of many frames, added up against their noise."""

import numpy as np
import pytest

from slam.dynamics.creep import STILL, added, creeps
from slam.dynamics.scene_flow import BodySteps, CameraStep, Followers
from slam.geometry import se3

SIGMA_M = 1e-3                      # of each coordinate of a body's step; the camera's is exact
EXACT = np.eye(6) * 1e18
KNOWN = np.diag([1e12, 1e12, 1e12, *[SIGMA_M**-2] * 3])
POINTS = np.array([0.0, 0.0, 2.0]) + 0.1 * np.random.default_rng(0).normal(size=(50, 3))


def creeping_share(step_m, runs=200, frames=20):
    """How many of `runs` things that move by `step_m` a frame are seen to creep at the end."""
    rng = np.random.default_rng(1)
    camera = CameraStep(np.eye(4), EXACT, 0.1, 0.0)
    drifts = [STILL] * runs
    for _ in range(frames):
        relative = np.tile(np.eye(4), (runs, 1, 1))
        relative[:, :3, 3] = rng.normal(size=(runs, 3)) * SIGMA_M
        relative[:, 0, 3] += step_m
        steps = BodySteps(relative, np.tile(KNOWN, (runs, 1, 1)),
                          [Followers(POINTS, np.full(50, np.nan))] * runs, np.zeros(runs, bool))
        drifts = added(drifts, camera, steps, se3.exp(np.array([0.3, 1.0, 0.0, 5.0, 0.0, 0.0])))
    return np.mean([creeps(drift) for drift in drifts])


@pytest.mark.parametrize(("step_m", "share"), [(0.0, 0.0), (4e-3, 1.0)])
def test_steps_within_their_noise_are_told_once_they_add_up(step_m, share):
    # One step of 4 mm is 2.3 deviations of all three coordinates together, and says nothing.
    assert creeping_share(step_m, frames=1) == 0.0
    assert creeping_share(step_m) == share


def test_nothing_parked_is_no_error():
    camera = CameraStep(np.eye(4), EXACT, 0.1, 0.0)
    none = BodySteps(np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), [], np.zeros(0, bool))
    assert added([], camera, none, np.eye(4)) == []
