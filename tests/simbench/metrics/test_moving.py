"""What counts as moving, and what a straight line through a jittering truth scores."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simbench.metrics.moving import moving_frames, truth_smoothness_floor
from simbench.sequence import open_sequence
from simbench.types import ObjectPoses
from slam.geometry import se3
from synthetic import smooth_poses, world

KITTI = Path(__file__).resolve().parents[4] / "shared" / "data" / "kitti_tracking_0003"


def straight(count: int, step_m: float) -> np.ndarray:
    t = np.zeros((count, 3))
    t[:, 0] = step_m * np.arange(count)
    return se3.from_rotation_translation(np.eye(3), t)


def test_exact_truth_is_judged_frame_by_frame():
    L = np.concatenate([straight(4, 0.0), straight(4, 0.01)])
    valid = np.ones(8, dtype=bool)
    valid[6] = False
    moving = moving_frames(ObjectPoses(L, valid), np.arange(8) * 0.1, exact=True)
    assert moving.tolist() == [False] * 5 + [True, False, False]
    turning = se3.exp(np.outer(np.arange(4), [0.0, 0.0, np.radians(0.06), 0.0, 0.0, 0.0]))
    assert moving_frames(ObjectPoses(turning, np.ones(4, bool)), np.arange(4) * 0.1, True)[1:].all()


def test_a_parked_car_whose_truth_jitters_does_not_move():
    rng = np.random.default_rng(0)
    stamps = np.arange(30) * 0.1
    jitter = se3.exp(np.concatenate([0.001 * rng.normal(size=(30, 3)),
                                     0.05 * rng.normal(size=(30, 3))], axis=1))
    valid = np.ones(30, dtype=bool)
    assert not moving_frames(ObjectPoses(jitter, valid), stamps, exact=False).any()
    driving = ObjectPoses(straight(30, 0.3) @ jitter, valid)
    assert moving_frames(driving, stamps, exact=False).tolist() == [False] + [True] * 29


def test_the_floor_of_a_steady_motion_is_zero_and_of_a_jittering_one_its_jitter():
    stamps = np.arange(200) * 0.1
    used = np.arange(200) > 0
    assert truth_smoothness_floor(stamps, straight(200, 0.3), used)["E_t"] < 1e-12
    rng = np.random.default_rng(0)
    poses = straight(200, 0.3)
    steps = se3.exp(np.c_[np.zeros((200, 3)), 0.3 + 0.02 * rng.normal(size=200),
                          np.zeros((200, 2))])
    for k in range(1, 200):
        poses[k] = poses[k - 1] @ steps[k]
    floor = truth_smoothness_floor(stamps, poses, used)
    assert floor["E_t"] == pytest.approx(0.02 * np.sqrt(2 / np.pi), rel=0.15)   # mean |Gaussian|
    assert truth_smoothness_floor(stamps, poses, np.arange(200) < 2) is None


@pytest.mark.skipif(not KITTI.is_dir(), reason=f"{KITTI} is not here")
def test_the_floors_of_kitti_tracking_0003_and_who_drives_there():
    truth = open_sequence(KITTI).truth.trajectories
    used = np.arange(30) > 0
    floor = truth_smoothness_floor(truth.stamps_s, truth.T_world_camera, used)
    assert floor["E_t"] == pytest.approx(0.050, abs=1e-3)
    moving = {i: moving_frames(o, truth.stamps_s, exact=False) for i, o in truth.objects.items()}
    assert [i for i, m in sorted(moving.items()) if m.any()] == [1, 2]
    car = truth_smoothness_floor(truth.stamps_s, truth.objects[1].T_world_object, moving[1])
    assert car["E_t"] == pytest.approx(0.061, abs=1e-3)


def test_the_synthetic_world_moves_as_the_other_tests_take_it_to():
    truth = world()
    moving = [moving_frames(o, truth.stamps_s, True)[1:] for o in truth.objects.values()]
    assert moving[0].all()
    assert moving[1].all()
    assert not moving[2].any()
    assert smooth_poses(3, np.random.default_rng(0)).shape == (3, 4, 4)
