"""Landmarks and dead keyframes follow what they hang on; one thing seen twice is one landmark."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slam.dpl.features import Features, KeyLines, KeyPoints
from slam.dpl.keyframes import PointLineMap, shared_landmarks
from slam.geometry import se3


def features(points=4, lines=2):
    return Features(
        KeyPoints(np.zeros((points, 2)), np.zeros(points, np.int32), np.zeros(points),
                  np.zeros((points, 32), np.uint8), np.zeros(points)),
        KeyLines(np.zeros((lines, 2, 2)), np.zeros((lines, 32), np.uint8), np.zeros((lines, 2))))


def map_of(poses, point_of, line_of):
    map_ = PointLineMap()
    rng = np.random.default_rng(0)
    map_.points.add(rng.normal(size=(6, 1, 3)), np.zeros((6, 32), np.uint8),
                    np.zeros(6, np.int32), np.zeros(3), 0)
    map_.lines.add(rng.normal(size=(3, 2, 3)), np.zeros((3, 32), np.uint8),
                   np.zeros(3, np.int32), np.zeros(3), 0)
    for i, T in enumerate(poses):
        map_.add_keyframe(i, T, features(), np.array(point_of[i]), np.array(line_of[i]))
    return map_


POSES = se3.exp(np.random.default_rng(1).normal(size=(3, 6)) * 0.3)
POINTS = [[0, 1, 2, -1], [1, 2, 3, 4], [2, 3, 5, -1]]
LINES = [[0, -1], [0, 1], [1, 2]]


def test_a_line_stays_where_it_was_as_its_reference_keyframe_sees_it():
    map_ = map_of(POSES, POINTS, LINES)
    map_.lines.reference[:] = [0, 1, 2]
    before = map_.poses()
    seen = [se3.transform_points(se3.inverse(before[i]), map_.lines.xyz[i]) for i in range(3)]
    for keyframe, step in zip(map_.keyframes, np.eye(6)[:3] * 0.2, strict=True):
        keyframe.T_world_camera = se3.exp(step) @ keyframe.T_world_camera
    map_.follow_references(before, map_.poses(), np.arange(6), np.arange(3))
    for i, keyframe in enumerate(map_.keyframes):
        assert_allclose(se3.transform_points(se3.inverse(keyframe.T_world_camera),
                                             map_.lines.xyz[i]), seen[i], atol=1e-12)


def test_a_dead_keyframe_goes_where_the_one_goes_that_shares_most_with_it():
    map_ = map_of(POSES, POINTS, LINES)
    dead = map_.keyframes[2]
    map_.drop_keyframe(dead)
    assert dead.parent == 1                       # three landmarks in common, one with keyframe 0
    assert_allclose(map_.pose(2), POSES[2], atol=1e-12)
    move = se3.exp(np.array([0.1, 0.0, 0.0, 1.0, 0.0, 0.0]))
    map_.keyframes[1].T_world_camera = move @ POSES[1]
    assert_allclose(map_.poses()[2], move @ POSES[2], atol=1e-12)


def test_merged_landmarks_are_the_oldest_and_a_keyframe_sees_each_once():
    map_ = map_of(POSES, POINTS, LINES)
    map_.merge(map_.points, np.array([3, 5]), np.array([1, 3]))       # 5 = 3 = 1
    assert_array_equal(np.flatnonzero(map_.points.alive), [0, 1, 2, 4])
    assert_array_equal(map_.keyframes[1].point_of, [1, 2, -1, 4])
    assert_array_equal(map_.keyframes[2].point_of, [2, 1, -1, -1])
    assert map_.points.found[1] == 3
    assert_array_equal(map_.keyframes[2].line_of, LINES[2])


def test_landmarks_in_common_are_counted_for_each_pair():
    map_ = map_of(POSES, POINTS, LINES)
    assert_array_equal(shared_landmarks(map_, map_.keyframes), [[4, 3, 1], [3, 6, 3], [1, 3, 5]])


def test_rows_of_landmarks_that_are_gone_are_had_by_new_ones():
    map_ = map_of(POSES, POINTS, LINES)
    map_.points.found[1] = 7
    identity = map_.points.identity.copy()
    map_.forget_landmarks(np.array([1, 4]), np.array([1]))
    assert [k.point_of.tolist() for k in map_.keyframes] == [
        [0, -1, 2, -1], [-1, 2, 3, -1], [2, 3, 5, -1]]
    assert [k.line_of.tolist() for k in map_.keyframes] == [[0, -1], [0, -1], [-1, 2]]
    xyz = np.arange(9.0).reshape(3, 1, 3)
    rows = map_.points.add(xyz, np.zeros((3, 32), np.uint8), np.zeros(3, np.int32), np.ones(3), 5)
    assert rows.tolist() == [1, 4, 6]
    assert_array_equal(map_.points.xyz[rows], xyz)
    assert map_.points.alive.all()
    assert map_.points.found[1] == 1
    assert map_.points.born[rows].tolist() == [5, 5, 5]
    assert map_.covisible(rows, np.array([1])).tolist() == [0, 0, 0]
    assert not set(map_.points.identity[rows]) & set(identity)      # a row is no name
    again = map_.points.add(xyz, np.zeros((3, 32), np.uint8), np.zeros(3, np.int32), np.ones(3), 6)
    assert again.tolist() == [7, 8, 9]


def test_the_oldest_of_merged_landmarks_stays_whatever_its_row():
    map_ = map_of(POSES, POINTS, LINES)
    map_.points.born[:] = [3, 2, 1, 4, 5, 6]
    map_.merge(map_.points, np.array([0]), np.array([2]))
    assert map_.points.alive.tolist() == [False, True, True, True, True, True]
    assert map_.keyframes[0].point_of.tolist() == [2, 1, -1, -1]


def test_of_a_dead_keyframe_only_its_place_is_kept():
    map_ = map_of(POSES, POINTS, LINES)
    map_.drop_keyframe(map_.keyframes[2])
    dead = map_.keyframes[2]
    assert (len(dead.features.points), len(dead.features.lines), len(dead.point_of),
            len(dead.line_of)) == (0, 0, 0, 0)
    assert map_.covisible(np.arange(6), np.arange(3)).tolist() == [4, 6, 0]


def test_who_sees_a_landmark_is_what_the_keyframes_say():
    rng = np.random.default_rng(2)
    map_ = PointLineMap()
    map_.points.add(rng.normal(size=(1500, 1, 3)), np.zeros((1500, 32), np.uint8),
                    np.zeros(1500, np.int32), np.zeros(3), 0)

    def seen():
        of = np.full(40, -1)
        some = rng.permutation(40)[:rng.integers(30)]
        of[some] = rng.choice([*range(30), *range(1490, 1500)], len(some), replace=False)
        return of

    for i in range(12):
        map_.add_keyframe(i, np.eye(4), features(40, 0), seen(), np.zeros(0, np.int64))
    for _ in range(60):
        map_.see_points(map_.keyframes[rng.integers(12)], seen())
    rows = rng.permutation(1500)[:700]
    assert_array_equal(map_.covisible(rows, np.zeros(0, np.int64)),
                       [np.isin(k.point_of, rows).sum() for k in map_.keyframes])
    assert_array_equal(map_.point_observers.count(np.arange(1600)),
                       [sum(r in k.point_of for k in map_.keyframes) for r in range(1600)])


def lonely_map(count):
    """Keyframes of which none sees anything."""
    poses = se3.exp(np.random.default_rng(3).normal(size=(count, 6)) * 0.3)
    return map_of(poses, [[-1] * 4] * count, [[-1] * 2] * count), poses


def test_a_keyframe_that_shares_nothing_hangs_on_a_living_one_beside_it():
    map_, poses = lonely_map(4)
    for number in (2, 1, 3):                       # 1 lies beside 2, which is gone
        map_.drop_keyframe(map_.keyframes[number])
        assert map_.keyframes[map_.keyframes[number].parent].alive
    assert_allclose(map_.poses(), poses, atol=1e-12)
    with pytest.raises(ValueError, match="last living keyframe"):
        map_.drop_keyframe(map_.keyframes[0])
    assert map_.newest() is map_.keyframes[0]


def test_keyframes_that_die_one_after_the_other_do_not_hang_on_each_other():
    map_ = map_of(POSES, [[-1] * 4, [0, 1, 2, 3], [0, 1, 2, 3]], [[-1] * 2] * 3)
    map_.drop_keyframe(map_.keyframes[1])          # hangs on keyframe 2
    map_.drop_keyframe(map_.keyframes[2])          # which shares nothing with a living one
    assert_allclose(map_.poses(), POSES, atol=1e-12)
