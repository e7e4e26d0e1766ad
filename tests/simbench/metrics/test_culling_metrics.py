"""Precision and recall of "dynamic" against exact truth."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from simbench.metrics.culling import CullingErrors, moving_at
from simbench.types import FrameTruth
from slam.geometry import se3
from slam.types import Frame, FrameEstimate, Judged
from synthetic import CAMERA

H, W = CAMERA.height, CAMERA.width


def truth_at(k, step_m):
    """A wall; its right half is part 1, which moves by step_m a frame while the camera turns."""
    part = np.zeros((H, W), np.int32)
    part[:, W // 2:] = 1
    part[0] = -1
    depth = np.full((H, W), 2.0, np.float32)
    T_part = np.array([np.eye(4), se3.exp(np.array([0, 0, 0, step_m * k, 0, 0]))])
    T_camera = se3.exp(np.array([0.0, 0.05 * k, 0, 0.1 * k, 0, 0]))
    return FrameTruth(k, 0.1 * k, T_camera, T_part, depth, part, np.maximum(part, 0))


class Truth:
    def __init__(self, step_m):
        self.step_m = step_m

    def frame(self, k):
        return truth_at(k, self.step_m)


PIXELS = np.array([[5.0, 20.0], [W - 5.0, 20.0], [W - 5.0, 0.0]])    # still, on part 1, nothing


@pytest.mark.parametrize(("step_m", "moving"), [(0.01, [False, True, False]),
                                                (0.004, [False, False, False])])
def test_what_moves_is_told_from_where_the_camera_turns(step_m, moving):
    """0.01 m in 0.1 s moves; 0.004 m does not, by 0.05 m/s."""
    assert_array_equal(moving_at(PIXELS, truth_at(3, step_m), truth_at(4, step_m), CAMERA), moving)


def judged(points_dynamic, segments_dynamic):
    # Of the three segments the second lies on what moves, and the third by two sevenths.
    edge = W // 2
    segments = np.array([[[2, 10], [20, 30]], [[edge + 2, 10], [W - 3, 30]],
                         [[edge - 11, 20], [edge + 4, 20]]], float)
    return Judged(PIXELS, np.array(points_dynamic), segments, np.array(segments_dynamic))


def seen(judgement, step_m=0.05, frames=3):
    measure = CullingErrors(Truth(step_m))
    for k in range(frames):
        measure(Frame(k, 0.1 * k, np.zeros((H, W, 3), np.uint8), np.ones((H, W), np.float32),
                      CAMERA), FrameEstimate(k, 0.1 * k, np.eye(4), np.eye(4), judged=judgement))
    return measure.metrics()


def test_precision_and_recall_pool_points_and_segments():
    assert seen(judged([False, True, False], [False, True, False])) == {"precision": 1.0,
                                                                        "recall": 1.0}
    assert seen(judged([True, True, False], [True, False, True])) == {"precision": 0.25,
                                                                      "recall": 0.5}


def test_a_share_of_nothing_is_absent():
    nothing = judged([False] * 3, [False] * 3)
    assert seen(nothing) == {"recall": 0.0}
    assert seen(nothing, step_m=0.0) == {}
    assert seen(None) == {}
    assert CullingErrors(None).metrics() == {}
