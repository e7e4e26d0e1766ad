"""The partial batch on sightings whose truth is known, given frame by frame."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from point_world import CAMERA, odometry, position_rms, taken, world
from slam.backend.config import BundleConfig, WindowConfig
from slam.backend.window import SlidingWindow
from slam.geometry import se3
from slam.map import STATIC, MapRecord

FRAMES = 24


def stream(T, xyz, s, path, config=None, spoil=None, window=None):
    """Feed a world to a window frame by frame; the record, and each pose as it first came out."""
    online = []
    if window is None:
        window = SlidingWindow(CAMERA, config or WindowConfig(), BundleConfig(), MapRecord())
    record = window.record
    static = record.bodies[STATIC]
    for row in range(len(T)):
        record.indices.append(row)
        if row == 0:
            static.begin(0, T[0])
            record.points.add_landmarks(np.zeros(len(xyz), np.int64), xyz)
        else:
            static.add(row, path.steps[row], path.information[row])
        seen = taken(s, s.frame == row)
        record.points.add_observations(spoil(row, seen) if spoil else seen)
        window.advance(row, [STATIC])
        online.append(static.poses[-1])
    return record, np.array(online), window


def test_poses_come_out_better_than_the_steps_lead_to():
    ratios = []
    for seed in range(3):
        T, xyz, s = world(seed, frames=FRAMES)
        path = odometry(T, seed)
        record, online, _ = stream(T, xyz + 0.02, s, path)
        ratios.append(position_rms(online, T) / position_rms(path.T_body_camera, T))
        assert position_rms(np.array(record.bodies[STATIC].poses), T) < position_rms(
            path.T_body_camera, T)
    assert np.mean(ratios) < 0.6


def test_what_leaves_the_window_is_worth_keeping():
    errors = {}
    for weight in (0.0, 0.5):
        config = WindowConfig(prior_weight=weight)
        errors[weight] = np.mean([
            position_rms(stream(T, xyz, s, odometry(T, seed), config)[1], T)
            for seed in range(8) for T, xyz, s in [world(seed, frames=FRAMES)]])
    assert errors[0.5] < 0.98 * errors[0.0]


def test_sightings_of_frames_that_have_left_pull_at_no_pose():
    T, xyz, s = world(0, frames=FRAMES)
    oldest = []

    def note(row, seen):
        oldest.append(row - window.points.sightings.frame.min(initial=row))
        return seen

    window = SlidingWindow(CAMERA, WindowConfig(frames=6), BundleConfig(), MapRecord())
    stream(T, xyz, s, odometry(T, 0), spoil=note, window=window)
    assert max(oldest) == 6          # noted before the frame comes in: five frames before the last


def test_a_landmark_away_for_longer_than_a_window_does_no_harm():
    T, xyz, s = world(0, frames=FRAMES)
    path = odometry(T, 0)
    away = taken(s, (s.landmark > 5) | (s.frame < 4) | (s.frame > 14))
    _, online, _ = stream(T, xyz, away, path)
    assert position_rms(online, T) < position_rms(path.T_body_camera, T)


def test_memory_does_not_grow_with_the_run():
    T, xyz, s = world(0, frames=FRAMES)
    _, _, window = stream(T, xyz, s, odometry(T, 0))
    assert np.unique(window.points.raw.frame).tolist() == list(range(FRAMES - 7, FRAMES))
    assert len(window.points.alive.number) <= len(xyz)


def nothing(row, seen):
    return seen if row < 10 or row > 13 else taken(seen, np.zeros(0, np.int64))


def two_points(row, seen):
    return taken(seen, seen.landmark < 2)


def no_numbers(row, seen):
    bad = np.where(np.arange(len(seen)) % 3 == 0, np.nan, 1.0)
    return replace(seen, uv_px=seen.uv_px * bad[:, None])


def one_place(row, seen):
    return replace(seen, uv_px=np.tile([[320.0, 240.0]], (len(seen), 1)),
                   rho_sigma=np.full(len(seen), np.inf))


def vanished(row, seen):
    return taken(seen, np.full(len(seen), row < 6))


@pytest.mark.parametrize("spoil", [nothing, two_points, no_numbers, one_place, vanished])
@pytest.mark.parametrize("known_steps", [True, False])
def test_bad_input_leaves_no_nan_and_no_jump(spoil, known_steps):
    T, xyz, s = world(1, frames=16)
    path = odometry(T, 1)
    if not known_steps:
        path = replace(path, information=path.information * 0.0)
    record, online, window = stream(T, xyz, s, path, spoil=spoil)
    assert np.isfinite(online).all()
    assert np.isfinite(window.points.alive.place).all()
    assert np.isfinite(window.points.alive.information).all()
    assert_allclose(np.array(record.bodies[STATIC].poses)[0], T[0])
    if known_steps and spoil is not one_place:
        steps = se3.inverse(online[:-1]) @ online[1:]
        true = se3.inverse(T[:-1]) @ T[1:]
        assert np.linalg.norm((steps - true)[:, :3, 3], axis=1).max() < 0.02
