"""The start of the refinement: P3P in RANSAC against outliers, and the predicted motion."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from slam.config import StartConfig
from slam.estimation.start import drawn_away, start_motion
from slam.geometry import se3
from slam.matches import PointMatches
from slam.tables import taken
from two_views import CAMERA, random_points, seen_in_b, some_motion

CONFIG = StartConfig()
STILL = np.eye(4)[None]


def error_of(T, T_true):
    e = se3.log(se3.inverse(T) @ T_true)
    return np.linalg.norm(e[:3]), np.linalg.norm(e[3:])


def among_walkers(rng, share, walk_m=0.05, sigma_px=0.5, n=300):
    """Matches of a room seen by a calm hand, a share of them on things that walk by at 1.3 m."""
    T = some_motion(rng, 0.002, 0.004)
    walked = T @ se3.exp(np.r_[0.0, 0.0, 0.0, walk_m, 0.0, 0.1 * walk_m])
    walks = rng.random(n) < share
    uv = rng.uniform([20, 20], [620, 460], (n, 2))
    rho = 1.0 / np.where(walks, rng.uniform(1.0, 1.6, n), rng.uniform(3.0, 6.0, n))
    room, person = seen_in_b(T, uv, rho), seen_in_b(walked, uv, rho)
    uv_b = np.where(walks[:, None], person[0], room[0]) + sigma_px * rng.normal(size=(n, 2))
    sigma = np.full(n, 0.004)
    noise = 0.004 * rng.normal(size=(2, n))
    return PointMatches(
        uv, rho + noise[0], sigma, uv_b, np.repeat(np.eye(2)[None], n, 0),
        np.where(walks, person[1], room[1]) + noise[1], sigma, np.zeros((n, 2)),
        np.zeros(n, np.int64), np.zeros(n, np.int64)), T, walked


def test_the_start_goes_with_the_room_and_not_with_who_walks_through_it():
    # A pose that follows the near ones has the far room within the threshold, too, once turned.
    for seed in range(12):
        matches, T, _ = among_walkers(np.random.default_rng(seed), 0.3)
        _, step = error_of(start_motion(matches, CAMERA, CONFIG, 0.3, STILL), T)
        assert step < 0.02


def test_a_pose_that_most_matches_fit_finely_is_not_left_for_one_between_two_motions():
    matches, T, walked = among_walkers(np.random.default_rng(7), 0.3)
    own = np.arange(len(matches))
    assert drawn_away(T, walked, matches, CAMERA, CONFIG, 0.3, own)
    assert not drawn_away(walked, T, matches, CAMERA, CONFIG, 0.3, own)
    assert not drawn_away(T, T, matches, CAMERA, CONFIG, 0.3, own)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_the_start_is_near_the_motion_however_many_matches_are_wrong(share):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        T = some_motion(rng, 0.08, 0.3)
        m = random_points(rng, T, 300)
        wrong = rng.random(300) < share
        uv_b = np.where(wrong[:, None], rng.uniform([0, 0], [640, 480], (300, 2)), m.uv_b)
        found = start_motion(replace(m, uv_b=uv_b), CAMERA, CONFIG, 0.3, STILL)
        turn, step = error_of(found, T)
        assert turn < 0.01
        assert step < 0.03


def test_a_good_prediction_is_kept():
    rng = np.random.default_rng(1)
    T = some_motion(rng)
    m = random_points(rng, T, 100)
    found = start_motion(m, CAMERA, CONFIG, 0.3, np.stack([np.eye(4), T]))
    turn, step = error_of(found, T)
    assert turn < 0.003
    assert step < 0.01


def test_without_depth_or_with_too_few_matches_there_is_none():
    rng = np.random.default_rng(2)
    m = random_points(rng, np.eye(4), 50)
    assert start_motion(taken(m, np.arange(CONFIG.min_points - 1)), CAMERA, CONFIG, 0.3,
                        STILL) is None
    assert start_motion(replace(m, rho_a=np.zeros(50)), CAMERA, CONFIG, 0.3, STILL) is None
    few = np.where(np.arange(50) < CONFIG.min_points - 1, m.rho_a, 0.0)
    assert start_motion(replace(m, rho_a=few), CAMERA, CONFIG, 0.3, STILL) is None


def test_equal_input_gives_equal_starts():
    rng = np.random.default_rng(3)
    m = random_points(rng, some_motion(rng), 600)
    assert_array_equal(start_motion(m, CAMERA, CONFIG, 0.3, STILL),
                       start_motion(m, CAMERA, CONFIG, 0.3, STILL))


def test_points_all_in_one_place_do_not_break_it():
    rng = np.random.default_rng(4)
    m = random_points(rng, np.eye(4), 30)
    same = replace(m, uv_a=np.repeat(m.uv_a[:1], 30, 0), uv_b=np.repeat(m.uv_b[:1], 30, 0),
                   rho_a=np.repeat(m.rho_a[:1], 30))
    found = start_motion(same, CAMERA, CONFIG, 0.3, STILL)
    assert np.isfinite(found).all()
