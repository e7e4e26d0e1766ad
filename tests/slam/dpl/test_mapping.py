"""Which keyframe a map line follows, and which landmarks go."""

import numpy as np
from numpy.testing import assert_array_equal

from slam.dpl.config import DplConfig
from slam.dpl.features import Features, KeyLines, no_points
from slam.dpl.keyframes import PointLineMap
from slam.dpl.mapping import LocalMapper, line_misfit_px
from slam.geometry import se3
from slam.geometry.camera import project
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
ENDS = np.array([[[-1.0, 0.3, 4.0], [0.5, -0.1, 5.0]]])
MAPPER = LocalMapper(CAMERA, DplConfig())


def nearer(metres):
    return se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, metres]))


def seen_from(poses, off_px):
    """A line seen by keyframes whose segments lie `off_px` below where it is."""
    map_ = PointLineMap()
    map_.begin_part()
    map_.lines.add(ENDS, np.zeros((1, 32), np.uint8), np.zeros(1, np.int32), np.zeros(3), 0)
    for number, (T, off) in enumerate(zip(poses, off_px, strict=True)):
        uv = project(CAMERA, se3.transform_points(se3.inverse(T), ENDS[0]))[None] + [0.0, off]
        map_.add_keyframe(number, T, Features(no_points(), KeyLines(
            uv, np.zeros((1, 32), np.uint8), np.zeros((1, 2)))), np.zeros(0, np.int64),
            np.zeros(1, np.int64))
    return map_


def test_a_line_follows_the_keyframe_that_sees_it_widest_and_fits_it():
    for poses, off_px, reference in (((nearer(0), nearer(1)), (0, 0), 1),      # seen wider
                                     ((nearer(1), nearer(0)), (0, 0), 0),
                                     ((nearer(0), nearer(1)), (0, 4), 0),      # but misfits
                                     ((nearer(0), nearer(0)), (2, 0), 1)):
        map_ = seen_from(poses, off_px)
        MAPPER._choose_references(map_, map_.keyframes[1])
        assert_array_equal(map_.lines.reference, [reference])


def test_the_misfit_is_across_the_segment():
    map_ = seen_from([nearer(0)], [3.0])
    ends = map_.keyframes[0].features.lines.ends_px
    along = ends[0, 1] - ends[0, 0]
    wanted = 3.0 * abs(along[0]) / np.linalg.norm(along)
    np.testing.assert_allclose(line_misfit_px(ENDS, ends, np.eye(4), CAMERA), wanted)
    np.testing.assert_allclose(line_misfit_px(ENDS, ends + along, np.eye(4), CAMERA), wanted)


def test_lines_seen_once_or_seldom_found_go():
    map_ = seen_from([nearer(0), nearer(1)], [0.0, 0.0])
    map_.lines.add(np.repeat(ENDS, 2, axis=0), np.zeros((2, 32), np.uint8), np.zeros(2, np.int32),
                   np.zeros(3), 0)
    map_.lines.found[:], map_.lines.visible[:] = [9, 9, 1], [9, 9, 9]
    MAPPER._cull_landmarks(map_, now=3)
    # The first is seen by both keyframes; the second by none, the third is hardly ever found.
    assert_array_equal(map_.lines.alive, [True, False, False])
