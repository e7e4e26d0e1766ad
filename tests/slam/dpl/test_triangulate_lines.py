"""Lines where planes through segments meet."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slam.dpl.config import DplConfig
from slam.dpl.features import Features, KeyLines, no_points
from slam.dpl.keyframes import PointLineMap
from slam.dpl.triangulate_lines import along_rays, overlap, triangulate_line_pairs
from slam.geometry import se3
from slam.geometry.camera import project
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
CONFIG = DplConfig()
# The second camera stands 0.4 m higher: lines along the rows can be told.
POSES = np.stack([np.eye(4), se3.exp(np.array([0.0, 0.02, 0.0, 0.05, -0.4, 0.0]))])
ENDS = np.array([[[-1.0, 0.1, 4.0], [0.5, 0.1, 5.0]], [[-0.5, -0.6, 3.0], [0.6, -0.5, 3.5]]])


@pytest.mark.parametrize("seed", range(5))
def test_planes_meet_in_the_line_that_both_see(seed):
    rng = np.random.default_rng(seed)
    ends = rng.uniform([-2, -2, 3], [2, 2, 8], (20, 2, 3))
    between = rng.normal(size=3)
    far, angle_deg = along_rays(ends / 2.0, ends - between, between)
    known = angle_deg > 0.5
    assert known.sum() > 15
    assert_allclose(far[known], 2.0, rtol=1e-6)


def test_a_line_in_the_plane_of_the_motion_is_not_told():
    ends = np.array([[[-1.0, 0.0, 4.0], [1.0, 0.0, 4.0]]])
    between = np.array([0.5, 0.0, 0.0])
    assert along_rays(ends, ends - between, between)[1][0] < 1e-6


def test_overlap_is_of_the_shorter_segment():
    long = np.array([[[10.0, 20.0], [110.0, 20.0]]])
    for u, wanted in (((10, 60), 1.0), ((60, 160), 0.5), ((-90, 10), 0.0), ((np.nan, 50), 0.0)):
        beside = np.array([[[u[0], 25.0], [u[1], 25.0]]], float)
        assert_allclose(overlap(beside, long), wanted, atol=1e-9)


def map_seen_by_both(shift_px=0.0):
    """Two keyframes with both lines, of unknown depth; in the second they lie farther right."""
    map_ = PointLineMap()
    map_.begin_part()
    words = np.array([[15] * 32, [240] * 32], np.uint8)
    for number, T in enumerate(POSES):
        xyz = se3.transform_points(se3.inverse(T), ENDS.reshape(-1, 3))
        uv = project(CAMERA, xyz).reshape(-1, 2, 2)
        uv[..., 0] += number * shift_px
        map_.add_keyframe(number, T, Features(no_points(), KeyLines(uv, words, np.zeros((2, 2)))),
                          np.zeros(0, np.int64), np.full(2, -1))
    return map_


def test_segments_without_depth_become_a_line_that_both_keyframes_see():
    map_ = map_seen_by_both()
    first, second = map_.keyframes
    triangulate_line_pairs(map_, second, [first], CAMERA, CONFIG)
    assert_allclose(map_.lines.xyz, ENDS, atol=1e-9)
    assert_array_equal(first.line_of, second.line_of)
    assert_array_equal(map_.line_observers.count(first.line_of), 2)
    triangulate_line_pairs(map_, second, [first], CAMERA, CONFIG)     # they have one now
    assert map_.lines.count == 2


def test_a_segment_that_would_lie_elsewhere_in_the_other_picture_is_no_partner():
    map_ = map_seen_by_both(shift_px=150.0)
    triangulate_line_pairs(map_, map_.keyframes[1], map_.keyframes[:1], CAMERA, CONFIG)
    assert map_.lines.count == 0
