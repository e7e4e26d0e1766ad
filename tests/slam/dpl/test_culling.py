"""The epipolar constraint and Algorithm 1."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from slam.dpl.culling import cull_lines, cull_points, full_boxes, usable_boxes
from slam.dpl.epipolar import epipolar_distance, follow, fundamental
from slam.dpl.movers import _one_surface
from slam.geometry import se3
from slam.geometry.camera import project
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 160.0, 120.0, 320, 240)
BOX = np.array([[100.0, 50.0, 200.0, 150.0]])


def two_views(seed, n=80):
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-2, -1.5, 3.0], [2, 1.5, 8.0], (n, 3))
    T = se3.exp(np.array([*rng.uniform(-0.05, 0.05, 3), *rng.uniform(-0.4, 0.4, 3)]))
    K = CAMERA.matrix
    R, t = T[:3, :3], T[:3, 3]
    F = np.linalg.inv(K).T @ se3.skew(t) @ R @ np.linalg.inv(K)
    return F, project(CAMERA, xyz), project(CAMERA, se3.transform_points(T, xyz))


@given(st.integers(0, 50))
def test_what_stands_still_lies_on_its_epipolar_line(seed):
    F, a, b = two_views(seed)
    assert_allclose(epipolar_distance(F, a, b), 0.0, atol=1e-6)
    # eq. (4) is a distance in pixels: moving off along the line's normal by d changes it by d.
    line = np.c_[a, np.ones(len(a))] @ F.T
    normal = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    assert_allclose(epipolar_distance(F, a, b + 3.0 * normal), 3.0, atol=1e-6)


def test_the_fundamental_matrix_outvotes_movers():
    true, a, b = two_views(3, 120)
    line = np.c_[a, np.ones(len(a))] @ true.T
    b = b.copy()
    b[:30] += 9.0 * (line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True))[:30]
    F = fundamental(a, b, 1.0)
    distance = epipolar_distance(F, a, b)
    assert (distance[30:] < 1.0).mean() > 0.95
    assert (distance[:30] > 1.0).mean() > 0.9
    assert fundamental(a[:5], b[:5], 1.0) is None


def test_a_patch_that_changed_its_look_is_no_match():
    rng = np.random.default_rng(0)
    gray = cv2.GaussianBlur(rng.integers(0, 256, (120, 160), dtype=np.uint8), (0, 0), 2)
    points = np.array([[40.0, 40.0], [80.0, 60.0], [2.0, 2.0]])
    shifted = np.roll(gray, 2, axis=1)
    pair = follow(gray, shifted, points, 5, 15.0)
    assert_allclose(pair.now_px[:2] - points[:2], [[2, 0]] * 2, atol=0.1)
    assert_array_equal(pair.good, [True, True, False])
    assert not follow(gray, np.zeros_like(gray), points, 5, 15.0).good.any()


# Features: two in the box, near and far from the mover in it; one outside.
FEATURES = np.array([[120.0, 60.0], [180.0, 140.0], [98.0, 60.0], [20.0, 20.0]])
MOVER = np.array([[110.0, 60.0]])


def test_near_features_of_the_same_box_go():
    stays = cull_points(FEATURES, MOVER, BOX, np.array([False]), 15.0, 8.0)
    assert_array_equal(stays, [False, True, True, True])     # the third is near, but outside


def test_a_box_that_is_full_goes_whole():
    stays = cull_points(FEATURES, MOVER, BOX, np.array([True]), 15.0, 8.0)
    assert_array_equal(stays, [False, False, True, True])


def test_without_boxes_what_is_near_a_mover_goes():
    nowhere = np.zeros((0, 4))
    stays = cull_points(FEATURES, FEATURES[3:] + 5.0, nowhere, np.zeros(0, bool), 15.0, 8.0)
    assert_array_equal(stays, [True, True, True, False])


@pytest.mark.parametrize(("share_of", "full"), [("box", True), ("frame", False)])
def test_forty_percent_of_what(share_of, full):
    """Three of five corners of the box move, beside 100 features in the frame."""
    dynamic = np.array([[110.0, 60.0], [120.0, 70.0], [130.0, 80.0]])
    tested = np.concatenate([dynamic, [[150.0, 100.0], [160.0, 110.0], [10.0, 10.0]]])
    features = np.random.default_rng(0).uniform(0, 300, (100, 2))
    assert full_boxes(dynamic, features, BOX, 0.4, share_of, tested)[0] == full


def test_a_line_goes_with_the_box_it_lies_in_not_with_one_it_grazes():
    lines = np.array([[[110.0, 60.0], [190.0, 140.0]], [[0.0, 140.0], [110.0, 145.0]]])
    stays = cull_lines(lines, MOVER, BOX, np.array([True]), 15.0, 8.0)
    assert_array_equal(stays, [False, True])


def test_boxes_from_nowhere_are_not_used():
    boxes = np.array([[1.0, 1, 20, 20], [np.nan, 0, 5, 5], [5, 5, 5, 9], [900, 0, 950, 9],
                      [-9, -9, -1, -1], [-50, -50, 999, 999]])
    assert_array_equal(usable_boxes(boxes, 320, 240), [True, False, False, False, False, True])


def test_far_depths_that_noise_spreads_are_of_one_surface():
    sigma = 0.002
    near, far = np.array([4.0, 4.0, 40.0, 8.0, 0.0]), np.array([4.3, 4.8, 55.0, 60.0, 30.0])
    assert_array_equal(_one_surface(near, far, sigma), [True, False, True, False, False])
