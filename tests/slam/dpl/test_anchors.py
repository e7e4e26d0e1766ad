"""Landmarks aligned with the patch of their first sighting, and how well each is known."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from slam.dpl.anchors import Anchors, pinned, reweighed, sharpened
from slam.dpl.certainty import Certainty
from slam.dpl.config import AnchorConfig
from slam.dpl.features import KeyPoints
from slam.dpl.picture import Picture
from slam.dpl.pose import _moved, _whole_whitening, refine_pose
from slam.dpl.sightings import Sightings, covariance_of, whitening_of
from slam.factors import landmark_terms
from slam.geometry import se3
from slam.geometry.camera import back_project, project
from slam.residuals import camera_tuple
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
DEPTH_M = 2.0


def picture(T_a_b=None):
    """A wall with a random pattern, 2 m before camera a, as camera b sees it."""
    rng = np.random.default_rng(0)
    pattern = cv2.GaussianBlur(rng.uniform(0, 255, (240, 320)).astype(np.float32), (0, 0), 2.0)
    pattern = cv2.normalize(pattern, None, 20, 230, cv2.NORM_MINMAX)
    depth = np.full((240, 320), DEPTH_M, np.float32)
    if T_a_b is not None:
        n = np.array([0.0, 0.0, 1.0])
        T_b_a = se3.inverse(T_a_b)
        H = CAMERA.matrix @ (T_b_a[:3, :3] + np.outer(T_b_a[:3, 3], n) / DEPTH_M) @ np.linalg.inv(
            CAMERA.matrix)
        pattern = cv2.warpPerspective(pattern, H, (320, 240), flags=cv2.INTER_CUBIC)
    return Picture(np.clip(np.rint(pattern), 0, 255).astype(np.uint8), depth)


CORNERS = cv2.goodFeaturesToTrack(picture().gray, 60, 0.1, 12)[:, 0].astype(float)
CORNERS = CORNERS[(CORNERS > 30).all(axis=1) & (CORNERS < [290, 210]).all(axis=1)]
ROWS = np.arange(len(CORNERS)) + 1020                    # the table has to grow for them


def at_origin(numbers):
    """Poses of keyframes that all stand where the world begins."""
    return np.tile(np.eye(4), (len(numbers), 1, 1))


def anchored():
    anchors = Anchors(CAMERA, AnchorConfig(), 0.002)
    anchors.cut(ROWS, CORNERS, np.full(len(CORNERS), 1 / DEPTH_M), picture(), 0)
    return anchors


def test_landmarks_are_found_to_a_tenth_of_a_pixel_from_a_pixel_off():
    T = se3.exp(np.array([0.02, -0.03, 0.2, 0.08, 0.05, -0.15]))      # turned by 11°, nearer
    uv = project(CAMERA, se3.transform_points(se3.inverse(T), back_project(
        CAMERA, CORNERS, np.full(len(CORNERS), DEPTH_M))))
    found = anchored().align(ROWS, at_origin, T, uv + np.array([0.8, -0.6]), picture(T))
    assert found.converged.mean() > 0.8
    error = np.linalg.norm(found.uv_current - uv, axis=1)[found.converged]
    assert np.median(error) < 0.1
    assert np.mean(error < 0.3) > 0.95


def test_landmarks_without_a_patch_and_out_of_view_are_not_aligned():
    anchors = anchored()
    rows = np.array([ROWS[0], 5, 90_000])
    at = np.array([[-20.0, 5.0], [100.0, 100.0], [100.0, 100.0]])
    found = anchors.align(rows, at_origin, np.eye(4), at, picture())
    assert not found.converged.any()
    before = anchors.known.copy()
    anchors.cut(np.array([3]), np.array([[2.0, 2.0]]), np.array([0.5]), picture(), 0)
    assert_array_equal(anchors.known[:len(before)], before)            # too near the border


def test_only_aligned_points_move_and_are_known_better():
    n = 4
    points = KeyPoints(np.full((n, 2), 50.0), np.zeros(n, np.int32), np.zeros(n),
                       np.zeros((n, 32), np.uint8), np.ones(n))
    found = anchored().align(ROWS[:2], at_origin, np.eye(4), CORNERS[:2] + 0.4, picture())
    assert found.converged.all()
    moved = sharpened(points, np.array([3, 1]), found, 0.3)
    assert_allclose(moved.uv_px[[3, 1]], CORNERS[:2], atol=0.02)
    assert_array_equal(moved.uv_px[[0, 2]], 50.0)
    sigma = 1.0 / moved.whitening[[3, 1], 0]
    assert ((sigma > 0.3) & (sigma < 0.5)).all()
    assert_array_equal(moved.whitening[[0, 2]], 0.0)


@given(st.integers(0, 100))
def test_the_whitening_is_of_pixel_noise_and_landmark_together(seed):
    """L⁻¹ (Σ + V P Vᵀ) L⁻ᵀ = I."""
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.uniform(-0.3, 0.3, 6))
    xyz = rng.uniform([-1, -1, 2], [1, 1, 6], (3, 3))
    root = rng.uniform(-0.1, 0.1, (3, 3, 3))
    P = root @ np.swapaxes(root, 1, 2)
    pixel = np.array([[2.0, 0.3], [0.3, 0.5]]) * rng.uniform(0.1, 2)
    own = np.concatenate([np.tile(whitening_of(pixel[None]), (3, 1)), [[50.0], [50.0], [0.0]]], 1)
    found = _whole_whitening(T, xyz, own, P, camera_tuple(CAMERA))
    V = landmark_terms(np.tile(T, (3, 1, 1)), xyz, np.zeros((3, 2)), np.zeros(3), CAMERA).J_point
    for i, size in enumerate((3, 3, 2)):                  # the last has no depth of its own
        S = V[i] @ P[i] @ V[i].T
        S[:2, :2] += pixel
        S[2, 2] += 1 / 50.0**2
        L = np.zeros((3, 3))
        L[[0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]] = found[i]
        assert_allclose((L @ S @ L.T)[:size, :size], np.eye(size), atol=1e-9)
    assert_array_equal(found[2, 3:], 0.0)


@given(st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6), st.sampled_from([1.0, 1e-5, 0.0]))
def test_the_compiled_step_is_that_of_the_exponential(step, size):
    T, out = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, -1.0])), np.eye(4)
    _moved(T, size * np.array(step), out)
    assert_allclose(out, T @ se3.exp(size * np.array(step)), atol=1e-12)


def test_landmarks_with_uncertain_depth_pull_less_on_the_pose():
    """Half of the landmarks are 10 % too far: told so, the fit goes by the other half."""
    rng = np.random.default_rng(1)
    true = se3.exp(np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.1]))
    xyz = rng.uniform([-2, -1.5, 2.0], [2, 1.5, 6.0], (80, 3))
    uv = project(CAMERA, se3.transform_points(se3.inverse(true), xyz)) + rng.normal(0, 0.1, (80, 2))
    seen = Sightings(uv, np.tile([10.0, 0.0, 10.0, 0.0], (80, 1)), np.zeros(80))
    wrong = xyz.copy()
    wrong[::2] *= 1.1                                      # along the first camera's rays
    ray = xyz / np.linalg.norm(xyz, axis=1, keepdims=True)
    length2 = np.sum(xyz**2, axis=1)
    P = 1e-8 * np.eye(3) + (0.1**2 * length2 * (np.arange(80) % 2 == 0))[:, None, None] * (
        ray[:, :, None] * ray[:, None])
    near = true @ se3.exp(np.array([0.002, 0.0, 0.0, 0.02, -0.02, 0.0]))
    error = [np.linalg.norm(refine_pose(near, wrong, seen, CAMERA, 100.0, 30, given)
                            .T_world_camera[:3, 3] - true[:3, 3]) for given in (None, P)]
    assert error[1] < 0.005
    assert error[0] > 4 * error[1]


def test_a_landmark_is_known_better_with_every_keyframe_and_least_along_the_ray():
    certainty = Certainty()
    rows, xyz = np.array([2000, 3]), np.array([[0.0, 0.0, 4.0], [0.5, 0.0, 3.0]])
    spread = []
    for k in range(2):
        T = se3.exp(np.array([0, 0, 0, 0.2 * k, 0, 0]))
        camera_xyz = se3.transform_points(se3.inverse(T), xyz)
        seen = Sightings(project(CAMERA, camera_xyz), np.tile([2.0, 0.0, 2.0, 500.0], (2, 1)),
                         1.0 / camera_xyz[:, 2])
        certainty.add(rows, xyz, seen, T, CAMERA, 2.5)
        spread.append(np.sqrt(np.linalg.eigvalsh(certainty.covariance(rows, xyz[:, 2]))))
        if k == 0:
            P = certainty.covariance(rows, xyz[:, 2])[0]
            assert_allclose(np.sqrt(P[2, 2]), 0.002 * 4.0**2, rtol=0.01)      # σ_z = σ_ρ z²
            assert_allclose(np.sqrt(P[0, 0]), 0.5 * 4.0 / 300.0, rtol=0.01)
    assert (spread[1] < spread[0]).all()
    unknown = certainty.covariance(np.array([7, 50_000]), np.array([2.0, 2.0]))
    assert_allclose(unknown, np.tile(0.6**2 * np.eye(3), (2, 1, 1)))


def test_a_landmarks_own_pixel_is_held_tightly():
    n = 3
    points = KeyPoints(np.full((n, 2), 50.0), np.zeros(n, np.int32), np.zeros(n),
                       np.zeros((n, 32), np.uint8), np.ones(n), np.tile([0.0, 0, 0, 7.0], (n, 1)))
    held = pinned(points, np.array([1]), 0.05)
    assert_allclose(held.whitening, [[0, 0, 0, 7], [20, 0, 20, 7], [0, 0, 0, 7]])


def test_aligned_points_weigh_by_what_their_residuals_spread():
    rng = np.random.default_rng(3)
    n, own = 400, np.array([[0.02, 0.01], [0.01, 0.03]])
    points = KeyPoints(np.zeros((n, 2)), np.zeros(n, np.int32), np.zeros(n),
                       np.zeros((n, 32), np.uint8), np.ones(n),
                       np.pad(np.tile(whitening_of(own[None] + 0.09 * np.eye(2)), (n, 1)),
                              ((0, 0), (0, 1))))
    for sigma in (0.0, 0.2, 1.0):
        residual = rng.multivariate_normal([0, 0], own + sigma**2 * np.eye(2), n)
        residual[:20] = 50.0                                    # outliers do not count
        found = reweighed(points, np.arange(n), residual, 0.3, 0.06)
        expected = own + max(sigma, 0.06)**2 * np.eye(2)
        assert_allclose(covariance_of(found.whitening)[0], expected, rtol=0.3, atol=0.01)
    assert reweighed(points, np.arange(0), np.zeros((0, 2)), 0.3, 0.06) is points


@given(st.integers(0, 100))
def test_covariances_come_back_from_whitenings(seed):
    root = np.random.default_rng(seed).uniform(-1, 1, (5, 2, 2)) + np.eye(2)
    covariance = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(2)
    assert_allclose(covariance_of(whitening_of(covariance)), covariance, rtol=1e-9)
