"""Landmarks sought where no corner was found."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import box_world as bw
import slam
from slam.dpl.culling import StillGround
from slam.dpl.features import joined, no_points
from slam.dpl.landmarks import Landmarks
from slam.dpl.picture import Picture
from slam.dpl.seek import apart, open_to_view, to_seek
from slam.geometry import se3
from slam.geometry.camera import back_project
from slam.systems.registry import default_config
from slam.types import Intrinsics

CAMERA = Intrinsics(fx=300.0, fy=300.0, cx=159.5, cy=119.5, width=320, height=240)
SHAPE = (240, 320)
SIGMA = 0.002            # 1/m
MOVER = StillGround(np.array([[100.0, 100.0], [250.0, 60.0]]), np.array([[80.0, 80, 120, 160],
                    [10.0, 10, 60, 60]]), np.array([False, True]), 15.0, 8.0)


def test_what_is_nearer_hides_and_what_has_no_depth_does_not():
    depth = np.full(SHAPE, 3.0, np.float32)
    depth[:, 160:] = 1.0
    depth[:, 300:] = 0.0
    uv = np.array([[50.0, 50.0], [200.0, 50.0], [310.0, 50.0], [-5.0, 50.0], [50.0, 50.0],
                   [np.nan, 1.0]])
    z = np.array([3.0, 3.0, 3.0, 3.0, -3.0, 3.0])
    assert_array_equal(open_to_view(uv, z, depth, SIGMA), [True, False, True, False, False, False])


@given(st.integers(0, 2**32 - 1), st.floats(2.0, 30.0))
def test_those_kept_are_apart_and_those_dropped_are_not(seed, least):
    uv = np.random.default_rng(seed).uniform([-5, -5], [325, 245], (200, 2))
    kept = apart(uv, SHAPE, least)
    gap = np.linalg.norm(uv[:, None] - uv[None, kept], axis=2)
    gap[np.flatnonzero(kept), np.arange(kept.sum())] = np.inf
    assert gap[kept].min() >= least
    inside = (uv >= -0.5).all(axis=1) & (uv < np.array([319.5, 239.5])).all(axis=1)
    assert not kept[~inside].any()
    assert (gap[inside & ~kept].min(axis=1) < least).all()


def landmarks_at(uv_px, depth_m):
    table = Landmarks(1)
    xyz = back_project(CAMERA, uv_px, np.full(len(uv_px), depth_m))
    table.add(xyz[:, None], np.zeros((len(xyz), 32), np.uint8), np.zeros(len(xyz), np.int32),
              np.zeros(3), 0)
    return table


def seek(table, ground, beside=()):
    picture = Picture(np.zeros(SHAPE, np.uint8), np.full(SHAPE, 2.0, np.float32))
    return to_seek(table, np.arange(table.count), np.reshape(beside, (-1, 2)), np.eye(4), CAMERA,
                   picture, ground, SIGMA, 5.0)


def test_nothing_is_sought_near_what_moves_or_in_a_box_culled_whole():
    uv = np.array([[105.0, 100.0], [105.0, 150.0], [30.0, 30.0], [252.0, 60.0], [270.0, 60.0]])
    table = landmarks_at(uv, 2.0)
    assert sorted(seek(table, MOVER).rows) == [1, 4]
    assert sorted(seek(table, None).rows) == [0, 1, 2, 3, 4]


def test_of_landmarks_close_together_the_best_known_is_sought_and_none_beside_one_found():
    table = landmarks_at(np.array([[50.0, 50.0], [52.0, 50.0], [200.0, 100.0]]), 2.0)
    table.found[1] = 7
    sought = seek(table, None, beside=[[202.0, 101.0]])
    assert_array_equal(sought.rows, [1])
    np.testing.assert_allclose(sought.uv_px, [[52.0, 50.0]], atol=1e-9)


def test_joined_points_keep_what_is_known_of_each():
    some = no_points()
    assert len(joined(some, some)) == 0
    assert joined(some, some).whitening.shape == (0, 4)


def test_more_landmarks_are_found_than_corners_match_and_they_are_where_they_should_be():
    """A camera moves along a ray-cast room; without seeking the same run has fewer points."""
    camera = se3.from_rotation_translation(np.eye(3), np.linspace([0, 0, 0], [0.2, 0.05, 0.1], 6))
    frames = []
    for k, T in enumerate(camera):
        now = bw.render(T, {})
        frames.append(bw.Frame(k, k / bw.FPS, np.rint(now.rgb).astype(np.uint8),
                               now.depth_m.astype(np.float32), bw.CAMERA))
    found = {}
    config = default_config("orb")
    for apart_px in (5.0, 1e4):          # so far apart that none is sought
        system = slam.make("orb", bw.CAMERA, replace(config, anchors=replace(
            config.anchors, apart_px=apart_px)))
        estimates = [system.process(f) for f in frames]
        found[apart_px] = sum(e.inliers.get("points", 0) for e in estimates)
        error = se3.inverse(camera[0]) @ camera[-1] - estimates[-1].T_world_camera
        assert np.linalg.norm(error[:3, 3]) < 0.002
    assert found[5.0] > found[1e4]
