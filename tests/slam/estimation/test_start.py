"""The start of the refinement: P3P in RANSAC against outliers, and the predicted motion."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from slam.config import StartConfig
from slam.estimation.start import start_motion
from slam.geometry import se3
from slam.tables import taken
from two_views import CAMERA, random_points, some_motion

CONFIG = StartConfig()
STILL = np.eye(4)[None]


def error_of(T, T_true):
    e = se3.log(se3.inverse(T) @ T_true)
    return np.linalg.norm(e[:3]), np.linalg.norm(e[3:])


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
