"""Tracks of objects: identity, short stops, forgetting, prediction."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.config import DynamicConfig
from slam.dynamics.objects import ObjectTable
from slam.geometry import se3

H = se3.exp(np.array([0.0, 0.02, 0.0, 0.1, 0.0, 0.0]))


def table(**settings):
    return ObjectTable(DynamicConfig(**settings))


def test_tracks_follow_their_masks_through_new_labels():
    objects = table()
    first = objects.relabel({}, [4, 9], -np.inf, 0.0)
    assert len(set(first.values())) == 2
    second = objects.relabel({9: 4, 4: 9}, [4, 9, 12], 0.0, 0.1)
    assert second[9] == first[4]
    assert second[4] == first[9]
    assert second[12] not in first.values()
    third = objects.relabel({1: 12}, [1], 0.1, 0.2)
    assert third == {1: second[12]}
    assert set(objects.of_label(0.2)) == {1}


def test_track_numbers_are_never_used_twice():
    objects = table(forget_s=0.05)
    seen = [track for k in range(6)
            for track in objects.relabel({}, [1], k / 10 - 0.1, k / 10).values()]
    assert len(set(seen)) == 6


def test_a_track_without_a_mask_is_forgotten_after_its_time_and_not_before():
    objects = table(forget_s=1.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    objects.relabel({}, [], 0.0, 1.0)
    assert track in objects.states
    objects.relabel({}, [], 1.0, 1.1)
    assert track not in objects.states


def test_a_thing_that_moved_stays_dynamic_through_a_short_stop_only():
    objects = table(stay_dynamic_s=1.0, forget_s=10.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    assert objects.judged(track, 2, 0.0, H, 1.0)
    assert objects.judged(track, 0, 0.9, np.eye(4), 1.0)
    assert not objects.judged(track, 0, 1.1, np.eye(4), 1.0)
    assert objects.states[track].parked
    assert objects.judged(track, 3, 1.2, H, 1.0)
    assert not objects.states[track].parked


def test_a_thing_that_never_moved_is_parked_once_it_was_watched_for_a_while():
    objects = table(parked_after_s=0.3)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    for stamp_s, parked in ((0.1, False), (0.29, False), (0.31, True), (0.4, True)):
        assert not objects.judged(track, 0, stamp_s, np.eye(4), 1.0)
        assert objects.states[track].parked == parked


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_the_motion_expected_is_the_last_one_seen_from_the_camera(ratio):
    objects = table()
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    objects.judged(track, 2, 0.0, H, 1.0)
    T_world_camera = se3.exp(np.array([0.1, -0.2, 0.05, 1.0, 2.0, -0.5]))
    expected = objects.predicted_relative(track, T_world_camera, ratio)
    p_camera = np.array([0.3, -0.2, 5.0])
    p_world = se3.transform_points(T_world_camera, p_camera[None])
    moved = se3.transform_points(se3.exp(se3.log(H) * ratio), p_world)
    assert_allclose(se3.transform_points(T_world_camera @ expected, p_camera[None]), moved,
                    atol=1e-12)


def test_nothing_is_expected_of_the_unknown_and_the_parked():
    objects = table()
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    assert_allclose(objects.predicted_relative(track, np.eye(4), 1.0), np.eye(4))
    assert_allclose(objects.predicted_relative(999, np.eye(4), 1.0), np.eye(4))
    objects.judged(track, 2, 0.1, None, 1.0)              # its motion is not to be trusted
    assert_allclose(objects.predicted_relative(track, np.eye(4), 1.0), np.eye(4))
    objects.judged(track, 0, 9.0, H, 1.0)
    assert_allclose(objects.predicted_relative(track, np.eye(4), 1.0), np.eye(4))


def test_what_moves_within_doubt_must_do_so_twice():
    objects = table(stay_dynamic_s=1.0, forget_s=10.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    for stamp_s, moved in ((0.1, 0), (0.2, 1), (0.3, 0), (0.4, 2)):
        assert not objects.judged(track, moved, stamp_s, H, 0.1)
    assert objects.judged(track, 1, 0.5, H, 0.1)


@pytest.mark.parametrize(("moved", "believed"), [(1, False), (2, True)])
def test_a_new_thing_need_only_move_beyond_jumps_of_its_depths(moved, believed):
    objects = table(stay_dynamic_s=1.0, forget_s=10.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    assert objects.judged(track, moved, 0.1, H, 0.1) == believed
    assert objects.judged(track, 1, 0.2, H, 0.1)


def test_what_cannot_be_told_to_stand_is_not_parked():
    objects = table(parked_after_s=0.3, forget_s=10.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    for stamp_s, moved, parked in ((0.1, 0, False), (0.4, -1, False), (0.6, 0, False),
                                   (0.8, 0, True)):
        assert not objects.judged(track, moved, stamp_s, H, 0.1)
        assert objects.states[track].parked == parked


def test_a_jump_beyond_doubt_is_believed_at_once_and_doubtful_motion_keeps_it_moving():
    objects = table(stay_dynamic_s=1.0, forget_s=10.0)
    track = objects.relabel({}, [1], -np.inf, 0.0)[1]
    assert objects.judged(track, 3, 0.0, H, 0.1)
    assert objects.judged(track, 1, 0.9, H, 0.1)
    assert objects.judged(track, 0, 1.8, H, 0.1)      # 0.9 s after the last motion
