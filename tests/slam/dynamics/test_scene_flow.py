"""Moving or not: per second, in all three coordinates, beyond the noise."""

import numpy as np
import pytest

from slam.config import DynamicConfig
from slam.dynamics.scene_flow import BodySteps, CameraStep, Followers, moving, speed_sigma
from slam.geometry import se3

CONFIG = DynamicConfig(static_share_of_distance=0.0, static_inverse_depth_error=0.0)
DEPTH_ERROR = 2e-4               # 1/m, of passable stereo
STILL = np.eye(4)                # the camera's step
SURE = np.eye(6) * 1e12          # information of poses known perfectly
POINTS = np.random.default_rng(0).uniform([-0.5, -0.5, 4.0], [0.5, 0.5, 5.0], (50, 3))


def followers(points, rho_b=None):
    return Followers(points, np.full(len(points), np.nan) if rho_b is None else rho_b)


def moves(relative, static, own, points, dt_s, config, moved_before=False, T_a_b=STILL,
          rho_b=None, depth_error=0.0):
    """The answer for one object; beside others that stand it is the same."""
    seen = followers(points, rho_b)
    camera = CameraStep(T_a_b, static, dt_s, depth_error)
    alone = moving(camera, BodySteps(relative[None], own[None], [seen], np.array([moved_before])),
                   config)
    among = moving(camera, BodySteps(np.stack([np.eye(4), relative, np.eye(4)]),
                                     np.stack([SURE, own, SURE]),
                                     [followers(POINTS), seen, followers(POINTS[:7])],
                                     np.array([True, moved_before, False])), config)
    assert among[1] == alone[0]
    if static is SURE:
        assert among[[0, 2]].tolist() == [0, 0]
    return alone[0]


def shift(axis, distance_m):
    return se3.exp(np.r_[0.0, 0.0, 0.0, np.eye(3)[axis] * distance_m])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("dt_s", [0.02, 0.1, 0.5])
def test_the_threshold_is_a_speed_whatever_the_direction_and_the_frame_rate(axis, dt_s):
    limit = CONFIG.static_scene_flow_m_s
    assert moves(shift(axis, 1.05 * limit * dt_s), SURE, SURE, POINTS, dt_s, CONFIG)
    assert not moves(shift(axis, 0.95 * limit * dt_s), SURE, SURE, POINTS, dt_s, CONFIG)


def test_turning_in_place_is_moving():
    centre = POINTS.mean(axis=0)
    turn = se3.exp(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    about_centre = se3.from_rotation_translation(turn[:3, :3], centre - turn[:3, :3] @ centre)
    assert moves(about_centre, SURE, SURE, POINTS, 0.1, CONFIG)


def test_motion_within_the_noise_of_either_pose_is_none():
    sigma_m = 0.05
    unsure = np.diag(np.r_[np.full(3, 1e12), np.full(3, 1 / sigma_m**2)])
    small, large = shift(2, 2.0 * sigma_m), shift(2, 6.0 * sigma_m)
    for static, own in ((unsure, SURE), (SURE, unsure)):
        assert moves(small, static, own, POINTS, 0.1, CONFIG) <= 0
        assert moves(large, static, own, POINTS, 0.1, CONFIG)
    assert moves(small, SURE, SURE, POINTS, 0.1, CONFIG)


def test_noise_of_rotation_counts_by_the_distance():
    loose = np.diag(np.r_[np.full(3, 1 / 0.01**2), np.full(3, 1e12)])   # 4.5 cm at 4.5 m
    motion = shift(0, 0.08)
    assert moves(motion, loose, SURE, POINTS, 0.1, CONFIG) <= 0
    assert moves(motion, loose, SURE, POINTS * 0.1, 0.1, CONFIG)


def test_what_is_known_to_move_needs_less_to_go_on():
    slow = shift(0, 0.5 * CONFIG.static_scene_flow_m_s * 0.1)
    assert not moves(slow, SURE, SURE, POINTS, 0.1, CONFIG)
    assert moves(slow, SURE, SURE, POINTS, 0.1, CONFIG, moved_before=True)


def test_no_points_and_no_information_are_no_motion():
    assert not moves(shift(0, 1.0), SURE, SURE, np.zeros((0, 3)), 0.1, CONFIG)
    assert moves(shift(0, 1.0), np.zeros((6, 6)), SURE, POINTS, 0.1, CONFIG) == -1


def test_far_things_need_to_move_more():
    config = DynamicConfig(static_scene_flow_m_s=0.0, static_share_of_distance=0.01)
    for far in (1.0, 10.0):
        points = POINTS * far
        limit = 0.01 * np.quantile(points[:, 2], config.moving_share) * 0.1
        assert moves(shift(0, 1.05 * limit), SURE, SURE, points, 0.1, config)
        assert not moves(shift(0, 0.5 * limit), SURE, SURE, points, 0.1, config)


def test_a_far_thing_whose_depth_alone_changes_does_not_move():
    config, far = DynamicConfig(), POINTS + np.array([0.0, 0.0, 40.0])
    # Along the ray it is depth that changes, across it is seen.
    assert not moves(shift(2, 0.5), SURE, SURE, far, 0.1, config, depth_error=DEPTH_ERROR)
    assert moves(shift(0, 0.5), SURE, SURE, far, 0.1, config, depth_error=DEPTH_ERROR)
    assert moves(shift(2, 2.0), SURE, SURE, far, 0.1, config, depth_error=DEPTH_ERROR)
    assert moves(shift(2, 0.5), SURE, SURE, far, 0.1, config, depth_error=0.1 * DEPTH_ERROR)


def test_no_objects_are_none_that_move():
    nothing = BodySteps(np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), [], np.zeros(0, np.bool_))
    none = moving(CameraStep(STILL, SURE, 0.1, 0.0), nothing, CONFIG)
    assert none.shape == (0,)


def test_the_noise_of_carried_points_is_that_of_draws():
    rng = np.random.default_rng(1)
    root = 0.01 * rng.normal(size=(6, 6))
    covariance = root @ root.T
    xi = rng.multivariate_normal(np.zeros(6), covariance, 40_000)
    sigma = speed_sigma(np.linalg.inv(covariance)[None], POINTS[:3], np.zeros(3, np.int64))
    for p, stated in zip(POINTS, sigma, strict=False):
        moved = np.cross(xi[:, :3], p) + xi[:, 3:]
        assert stated == pytest.approx(np.sqrt(np.mean(np.sum(moved**2, axis=1))), rel=0.02)


def test_far_above_the_limit_is_beyond_doubt():
    limit = CONFIG.static_scene_flow_m_s * 0.1
    for times, level in ((0.9, 0), (1.1, 2), (1.4, 2), (1.6, 3)):
        assert moves(shift(0, times * limit), SURE, SURE, POINTS, 0.1, CONFIG) == level


def test_noise_that_hides_any_motion_is_no_sign_of_standing():
    unsure = np.eye(6) / 0.05**2
    assert moves(shift(0, 0.0), SURE, unsure, POINTS, 0.1, CONFIG) == -1
    assert moves(shift(0, 0.0), SURE, unsure * 1e4, POINTS, 0.1, CONFIG) == 0


DRIVE = shift(2, 4.0)            # a camera that drives past
BESIDE = POINTS + np.array([-15.0, 0.0, 20.0])   # what stands at the roadside


def carried_by_wrong_depth(points, error):
    """What a fit makes of standing points whose inverse depths are too large by `error` (1/m).

    Their pixels say where the true points went; the motion along the ray is free.
    """
    rho = 1.0 / points[:, 2]
    true = points * (rho / (rho - error))[:, None]
    seen_b = se3.transform_points(se3.inverse(DRIVE), true)
    wrong_b = seen_b * (1.0 / seen_b[:, 2] + error)[:, None] ** -1 / seen_b[:, 2:]
    return se3.transform_points(DRIVE, wrong_b).mean(axis=0) - points.mean(axis=0)


def test_standing_things_whose_depths_are_wrong_stand():
    config = DynamicConfig()
    step = carried_by_wrong_depth(BESIDE, 0.002)
    seems = se3.from_rotation_translation(np.eye(3), step)
    assert np.linalg.norm(step) > 1.5 * (config.static_scene_flow_m_s + 0.5) * 0.1
    rho_b = 1.0 / se3.transform_points(se3.inverse(DRIVE), BESIDE)[:, 2]
    assert moves(seems, SURE, SURE, BESIDE, 0.1, config, T_a_b=DRIVE, rho_b=rho_b) == 0
    # Without a drive past it, no error of depth explains that.
    assert moves(seems, SURE, SURE, BESIDE, 0.1, config, rho_b=1.0 / BESIDE[:, 2]) > 0
    # And more than depths can be wrong by, or off the epipolar line, is motion.
    twice = se3.from_rotation_translation(np.eye(3), 3.0 * step)
    assert moves(twice, SURE, SURE, BESIDE, 0.1, config, T_a_b=DRIVE) > 0
    assert moves(shift(1, 0.2), SURE, SURE, BESIDE, 0.1, config, T_a_b=DRIVE) == 3


def test_motion_along_the_ray_needs_the_measured_depths_to_agree():
    motion, far = shift(2, 1.0), POINTS * [0.1, 0.1, 1.0] + np.array([0.0, 0.0, 16.0])
    carried = far[:, 2] + 1.0
    for seen, level in ((1.0 / carried, 3), (1.0 / far[:, 2], 0), (None, 3)):
        assert moves(motion, SURE, SURE, far, 0.1, CONFIG, rho_b=seen) == level


def test_depths_of_a_far_thing_that_jump_leave_doubt():
    config, far = DynamicConfig(), POINTS + np.array([0.0, 0.0, 40.0])
    jump = config.depth_jumps * DEPTH_ERROR * far[:, 2].mean() ** 2
    for times, level in ((0.9, 0), (2.5, 1), (4.0, 3)):
        assert moves(shift(2, times * jump), SURE, SURE, far, 0.1, config,
                     depth_error=DEPTH_ERROR) == level
