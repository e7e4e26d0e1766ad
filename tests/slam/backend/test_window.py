"""The partial batch on sightings whose truth is known, given frame by frame."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from point_world import CAMERA, odometry, position_rms, stream, world
from slam.backend.config import BundleConfig, WindowConfig
from slam.backend.window import SlidingWindow
from slam.geometry import se3
from slam.map import STATIC, MapRecord
from slam.tables import taken

FRAMES = 24


def window_of(**settings):
    return SlidingWindow(CAMERA, WindowConfig(**settings), BundleConfig(), MapRecord())


def test_poses_come_out_better_than_the_steps_lead_to():
    ratios = []
    for seed in range(3):
        T, xyz, s = world(seed, frames=FRAMES)
        path = odometry(T, seed)
        window = window_of()
        online = stream(T, path, window, (xyz + 0.02, s))
        ratios.append(position_rms(online, T) / position_rms(path.T_body_camera, T))
        assert position_rms(np.array(window.record.bodies[STATIC].poses), T) < position_rms(
            path.T_body_camera, T)
    assert np.mean(ratios) < 0.6


def test_what_leaves_the_window_is_worth_keeping():
    errors = {}
    for weight in (0.0, 0.5):
        errors[weight] = np.mean([
            position_rms(stream(T, odometry(T, seed), window_of(prior_weight=weight), (xyz, s)), T)
            for seed in range(8) for T, xyz, s in [world(seed, frames=FRAMES)]])
    assert errors[0.5] < 0.98 * errors[0.0]


def test_sightings_of_frames_that_have_left_pull_at_no_pose():
    T, xyz, s = world(0, frames=FRAMES)
    oldest = []

    def note(row, seen):
        oldest.append(row - window.points.sightings.frame.min(initial=row))
        return seen

    window = window_of(frames=6)
    stream(T, odometry(T, 0), window, (xyz, s), spoil=note)
    assert max(oldest) == 6          # noted before the frame comes in: five frames before the last


def test_a_landmark_away_for_longer_than_a_window_does_no_harm():
    T, xyz, s = world(0, frames=FRAMES)
    path = odometry(T, 0)
    away = taken(s, (s.landmark > 5) | (s.frame < 4) | (s.frame > 14))
    online = stream(T, path, window_of(), (xyz, away))
    assert position_rms(online, T) < position_rms(path.T_body_camera, T)


def test_memory_does_not_grow_with_the_run():
    T, xyz, s = world(0, frames=FRAMES)
    window = window_of()
    stream(T, odometry(T, 0), window, (xyz, s))
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
    window = window_of()
    online = stream(T, path, window, (xyz, s), spoil=spoil)
    assert np.isfinite(online).all()
    assert np.isfinite(window.points.alive.place).all()
    assert np.isfinite(window.points.alive.information).all()
    assert_allclose(np.array(window.record.bodies[STATIC].poses)[0], T[0])
    if known_steps and spoil is not one_place:
        steps = se3.inverse(online[:-1]) @ online[1:]
        true = se3.inverse(T[:-1]) @ T[1:]
        assert np.linalg.norm((steps - true)[:, :3, 3], axis=1).max() < 0.02
