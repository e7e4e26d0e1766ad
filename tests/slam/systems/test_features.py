"""Segments lost and found: how long flow alone carries them, and how long they are said to live."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal

import box_world as bw
from slam.config import SdplConfig
from slam.frontend.observe import observe
from slam.systems.features import Detected, FeatureTracker
from slam.systems.judgement import lost
from slam.types import Frame

SHAPE = bw.CAMERA.height, bw.CAMERA.width
NONE = np.zeros((0, 2, 2))
SEGMENT = np.array([[[20.0, 30.0], [90.0, 50.0]]])
OTHER = np.array([[[20.0, 90.0], [120.0, 80.0]]])


def wall(k):
    """A blank wall, 2 m away."""
    return observe(Frame(k, k / 10, np.zeros((*SHAPE, 3), np.uint8),
                         np.full(SHAPE, 2.0, np.float32), bw.CAMERA))


def tracker_after(shown, unseen_frames=3):
    """The tracker, and the segments' numbers in each frame, where frames show these segments."""
    config = SdplConfig()
    tracker = FeatureTracker(replace(config, segments=replace(config.segments,
                                                              unseen_frames=unseen_frames)))
    numbers = []
    for k, segments in enumerate(shown):
        detected = Detected(np.zeros(SHAPE, np.float32), segments)
        if k == 0:
            tracker.restart(wall(k), detected)
        else:
            carried = tracker.segments.endpoints_px
            tracker.advance(wall(k), detected, replace(
                lost(""), line_index=np.arange(len(carried)), line_endpoints=carried))
        numbers.append(tracker.segments.track_id.tolist())
    return tracker, numbers


def test_a_segment_that_is_missed_for_a_while_is_the_same_one():
    _, numbers = tracker_after([SEGMENT, NONE, NONE, NONE, SEGMENT, NONE, NONE, NONE, SEGMENT])
    assert [len(each) for each in numbers] == [1] * 9
    assert len({each[0] for each in numbers}) == 1


def test_a_segment_missed_for_longer_ends_and_comes_back_as_another():
    tracker, numbers = tracker_after([SEGMENT, SEGMENT, NONE, NONE, NONE, NONE, SEGMENT])
    assert [len(each) for each in numbers] == [1, 1, 1, 1, 1, 0, 1]
    assert numbers[-1] != numbers[0]
    # Two frames seen, three carried; and the new one's single frame.
    assert_array_equal(sorted(tracker.finished_static_line_lengths()), [1, 5])


def test_lengths_count_all_tracks_those_of_a_restart_among_them():
    both = np.concatenate([SEGMENT, OTHER])
    tracker, numbers = tracker_after([both, both, SEGMENT], unseen_frames=0)
    assert [len(each) for each in numbers] == [2, 2, 1]
    tracker.restart(wall(3), Detected(np.zeros(SHAPE, np.float32), OTHER))
    assert_array_equal(sorted(tracker.finished_static_line_lengths()), [1, 2, 3])
