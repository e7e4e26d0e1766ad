"""Motions joined with those before them: less noise, no lag, nothing across a collision."""

from __future__ import annotations

import numpy as np
import pytest

from slam.config import SmoothMotionConfig
from slam.dynamics.smooth_motion import BodyVelocity, MeasuredMotions, keep_moving
from slam.geometry import se3

CONFIG = SmoothMotionConfig()
DT_S = 0.1
SIGMA = np.array([0.02, 0.02, 0.02, 0.05, 0.05, 0.05])   # rad and m, of one measured motion
START = se3.exp(np.array([0.3, -0.2, 0.5, 4.0, 1.0, 9.0]))
TURNING_CAR = np.array([0.0, 0.4, 0.0, 0.0, 0.0, 8.0])   # rad/s and m/s in its own frame


def measured(T_before, T_after, k, rng=None):
    """The motion between two poses, as a pose seen by a camera at the origin errs."""
    noise = np.eye(4) if rng is None else se3.exp(SIGMA * rng.standard_normal(6))
    H = T_after @ noise @ se3.inverse(T_before)
    A = se3.adjoint(T_before)
    return motions(H, A @ np.diag(SIGMA**2) @ A.T, k)


def motions(H, covariance, k, place=START[:3, 3]):
    return MeasuredMotions(H[None], covariance[None], place[None], k * DT_S, (k + 1) * DT_S)


def velocity_after(before, motion):
    return keep_moving([before], motion, CONFIG).of(0)


def poses(twists):
    out = [START]
    for twist in twists:
        out.append(out[-1] @ se3.exp(twist * DT_S))
    return out


def errors(H, T_before, T_after):
    E = se3.inverse(H @ T_before) @ T_after
    return np.linalg.norm(E[:3, 3]), np.linalg.norm(se3.log(E)[:3])


@pytest.mark.parametrize("seed", range(3))
def test_a_car_in_a_turn_is_known_better_than_from_one_motion(seed):
    rng = np.random.default_rng(seed)
    path = poses([TURNING_CAR] * 60)
    velocity, raw, joined = None, [], []
    for k in range(60):
        motion = measured(path[k], path[k + 1], k, rng)
        velocity = velocity_after(velocity, motion)
        raw.append(errors(motion.H_world[0], path[k], path[k + 1]))
        joined.append(errors(velocity.motion(DT_S)[0], path[k], path[k + 1]))
    ratio = np.sqrt(np.mean(np.square(joined[10:]), axis=0) / np.mean(np.square(raw[10:]), axis=0))
    # What 2 m/s² and 2 rad/s² over 0.1 s leave a steady filter: 0.68 and 0.93 of such noise.
    assert ratio[0] < 0.75
    assert ratio[1] < 1.0


def test_without_noise_the_measured_motions_come_back():
    path = poses([TURNING_CAR] * 5)
    velocity = None
    for k in range(5):
        velocity = velocity_after(velocity, measured(path[k], path[k + 1], k))
        np.testing.assert_allclose(velocity.motion(DT_S)[0] @ path[k], path[k + 1], atol=1e-9)


def test_after_a_collision_the_new_motion_stands_alone():
    thrown_back = -2.0 * TURNING_CAR
    path = poses([TURNING_CAR] * 8 + [thrown_back])
    velocity = None
    for k in range(9):
        velocity = velocity_after(velocity, measured(path[k], path[k + 1], k))
    np.testing.assert_allclose(velocity.motion(DT_S)[0] @ path[8], path[9], atol=1e-9)


def test_what_was_not_seen_in_between_starts_anew():
    path = poses([TURNING_CAR] * 4)
    rng = np.random.default_rng(0)
    before = velocity_after(None, measured(path[0], path[1], 0, rng))
    later = measured(path[3], path[4], 3, rng)
    velocity = velocity_after(before, later)
    np.testing.assert_allclose(velocity.motion(DT_S)[0], later.H_world[0], atol=1e-9)


def test_a_motion_that_is_hardly_known_is_the_expected_one():
    path = poses([TURNING_CAR] * 2)
    before = velocity_after(None, measured(path[0], path[1], 0))
    blind = motions(np.eye(4), 1e12 * np.eye(6), 1)
    velocity = velocity_after(before, blind)
    np.testing.assert_allclose(velocity.motion(DT_S)[0] @ path[1], path[2], atol=1e-3)


def test_a_first_motion_has_the_covariance_that_was_measured():
    path = poses([TURNING_CAR])
    motion = measured(path[0], path[1], 0)
    _, covariance = velocity_after(None, motion).motion(DT_S)
    np.testing.assert_allclose(covariance, motion.covariance[0], rtol=1e-6, atol=1e-9)


def test_each_of_several_bodies_goes_as_it_would_alone():
    rng = np.random.default_rng(3)
    path = poses([TURNING_CAR] * 3)
    before = velocity_after(None, measured(path[0], path[1], 0, rng))
    long_ago = BodyVelocity(-1.0, before.T_world_body, before.twist, before.covariance)
    one = measured(path[1], path[2], 1, rng)
    three = MeasuredMotions(*(np.repeat(x, 3, axis=0) for x in
                              (one.H_world, one.covariance, one.place_world)),
                            one.before_s, one.stamp_s)
    together = keep_moving([before, None, long_ago], three, CONFIG)
    for i, alone in enumerate([before, None, None]):
        np.testing.assert_allclose(together.of(i).motion(DT_S)[0],
                                   velocity_after(alone, one).motion(DT_S)[0], atol=1e-12)
