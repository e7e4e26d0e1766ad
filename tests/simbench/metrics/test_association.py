"""A track is whose it stood on most; a change of track is a switch."""

from __future__ import annotations

import numpy as np

from simbench.metrics.association import (
    identity_switches,
    nearest_objects,
    owners,
    scored_rows,
)
from simbench.metrics.estimates import NO_OBJECT, ObjectMotions
from synthetic import exact_camera, exact_motions, world

TRUTH = world()


def rows(frame: list[int], track: list[int], stands_on: list[int]) -> ObjectMotions:
    count = len(frame)
    eye = np.repeat(np.eye(4)[None], count, 0)
    return ObjectMotions(np.array(frame), np.array(track), eye, np.zeros((count, 3)), eye,
                         np.array(stands_on))


def test_a_track_belongs_to_the_object_it_stood_on_most_often():
    motions = rows([1, 2, 3, 1, 2, 3], [5, 5, 5, 1, 1, 1], [2, 2, 1, 0, 0, 0])
    assert owners(motions.track, motions.stands_on) == {1: NO_OBJECT, 5: 2}


def test_the_number_of_a_track_does_not_decide():
    motions = rows([1, 2], [1, 1], [2, 2])
    owner = owners(motions.track, motions.stands_on)
    assert list(scored_rows(motions, owner, 2)) == [0, 1]
    assert not len(scored_rows(motions, owner, 1))


def test_of_two_tracks_on_an_object_the_one_standing_on_it_counts_then_the_longer():
    motions = rows([1, 1, 2, 2, 3], [4, 8, 4, 8, 8], [1, 1, 1, 2, 1])
    owner = {4: 1, 8: 1}
    assert list(scored_rows(motions, owner, 1)) == [1, 2, 4]   # 8 is longer; in 2 it is elsewhere


def test_switches_count_changes_of_track_and_not_a_second_track_beside():
    assert identity_switches(rows([1, 2, 3, 4], [4, 4, 8, 8], [1, 1, 1, 1]), 1) == 1
    assert identity_switches(rows([1, 2, 2, 3], [8, 4, 8, 8], [1, 1, 1, 1]), 1) == 0
    assert identity_switches(rows([1, 2, 3], [4, 8, 4], [1, 1, 1]), 1) == 2
    assert identity_switches(rows([1, 3], [4, 4], [1, 1]), 1) == 0   # a gap is no switch


def test_the_nearest_object_is_found_through_the_camera():
    camera = exact_camera(TRUTH)
    motions = exact_motions(TRUTH, camera, {1: 7, 2: 3})
    assert np.array_equal(nearest_objects(motions, TRUTH), motions.stands_on)
