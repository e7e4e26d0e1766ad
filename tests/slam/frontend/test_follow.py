"""Features carried by flow and aligned on images, on scenes whose motion is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import box_world as bw
from slam.config import NoiseConfig
from slam.frontend.follow import (
    CORNER_KIND,
    align_points,
    align_segments,
    fit_endpoints,
    follow_points,
    follow_segments,
    match_segments,
    sample_positions,
)
from slam.frontend.observe import NO_GROUP, observe
from slam.frontend.refine import RefineConfig, prepare_image
from slam.frontend.support import surface_image
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.matches import LineMatches, PointMatches
from slam.types import FlowField, Frame, Points2D, Segments2D
from wave_pictures import lattice, picture

NOISE = NoiseConfig()


@pytest.fixture(scope="module")
def pair():
    """Two frames of a room with one moving box: camera, box, observations, exact flow."""
    camera = bw.hand_held(3)[1:]
    box = bw.Box((0.6, 0.5, 0.5), bw.moving(0.1, 0.1, -0.3, 2, (0.05, 0.02, 0.02), (0.0, 0.03, 0)))
    a, b = bw.sequence(camera, {6: box})
    return camera, box, observe(a), observe(b), b.flow


def points_at(uv, observation):
    column, row = np.rint(uv).astype(int).T
    label = np.asarray(observation.frame.instance_id)[row, column]
    return Points2D(uv, np.ones(len(uv)), np.arange(len(uv)), label.astype(np.int32))


def carried_truly(camera, box, uv, rho, group):
    """Pixels and inverse depths in b of surface points of a."""
    world = se3.transform_points(camera[0], pinhole.rays(bw.CAMERA, uv) / rho[:, None])
    H = box.T_world_box[1] @ se3.inverse(box.T_world_box[0])
    world = np.where((group == 1)[:, None], se3.transform_points(H, world), world)
    seen = se3.transform_points(se3.inverse(camera[1]), world)
    return pinhole.project(bw.CAMERA, seen), 1.0 / seen[:, 2]


def follow(pair, uv, flow=None):
    _, _, a, b, true_flow = pair
    points = points_at(uv, a)
    group = (points.instance_id == 6).astype(np.int64)
    return follow_points(points, group, true_flow if flow is None else flow, a, b,
                         b.groups({6: 1}), NOISE)


def test_points_land_where_their_own_body_carries_them(pair):
    camera, box, a, _, _ = pair
    uv = np.random.default_rng(0).uniform([5, 5], [154, 114], (600, 2))
    matches, slopes, index = follow(pair, uv)
    assert len(matches) > 450
    assert set(matches.group) == {0, 1}
    assert set(matches.kind) == {CORNER_KIND}
    assert_array_equal(matches.uv_a, uv[index])
    expected, rho_b = carried_truly(camera, box, matches.uv_a, matches.rho_a, matches.group)
    off = np.linalg.norm(matches.uv_b - expected, axis=1)
    assert np.median(off) < 1e-3
    assert np.mean(off < 0.05) > 0.97             # the rest stand on a fold between two faces
    known = np.isfinite(matches.rho_sigma_b)
    assert known.mean() > 0.95
    relative = np.abs(matches.rho_b / rho_b - 1)[known]
    assert np.median(relative) < 1e-4
    assert np.mean(relative < 5e-3) > 0.97
    # The slope is that of the surface: it predicts the inverse depth two pixels on.
    column, row = np.rint(matches.uv_a).astype(int).T
    here = matches.rho_a + np.einsum("ni,ni->n", slopes, np.stack([column, row], 1) - matches.uv_a)
    assert np.median(np.abs(here / a.rho[row, column] - 1)) < 1e-4


def test_points_that_leave_their_body_are_dropped(pair):
    uv = np.random.default_rng(1).uniform([5, 5], [154, 114], (400, 2))
    _, _, a, b, _ = pair
    points = points_at(uv, a)
    group = (points.instance_id == 6).astype(np.int64)
    away = FlowField(np.broadcast_to(np.array([70.0, 0.0], np.float32), (120, 160, 2)))
    matches, _, index = follow_points(points, group, away, a, b, b.groups({6: 1}), NOISE)
    row, column = np.rint(matches.uv_b[:, 1]).astype(int), np.rint(matches.uv_b[:, 0]).astype(int)
    assert_array_equal(b.groups({6: 1})[row, column], group[index])
    unknown, _, index = follow_points(points, group, pair[4], a, b, b.groups({}), NOISE)
    assert not (unknown.group == 1).any()         # its mask takes part in no motion now
    assert NO_GROUP not in unknown.group


def test_points_whose_depth_no_motion_explains_are_dropped(pair):
    camera, _, a, b, flow = pair
    far = observe(replace(b.frame, depth_m=np.full((120, 160), 65535.0, np.float32)))
    matches, _, _ = follow((camera, None, a, far, flow),
                           np.random.default_rng(2).uniform([5, 5], [154, 114], (200, 2)))
    assert len(matches) == 0


def test_points_without_group_flow_or_depth_are_dropped(pair):
    _, _, a, b, flow = pair
    points = points_at(lattice((120, 160)), a)
    none = np.full(len(points), -1)
    assert len(follow_points(points, none, flow, a, b, b.groups({6: 1}), NOISE)[0]) == 0
    unknown = FlowField(np.full((120, 160, 2), np.nan, np.float32))
    assert len(follow(pair, points.uv_px, unknown)[0]) == 0
    bare = observe(replace(a.frame, depth_m=np.zeros((120, 160), np.float32)))
    group = (points.instance_id == 6).astype(np.int64)
    assert len(follow_points(points, group, flow, bare, b, b.groups({6: 1}), NOISE)[0]) == 0


def shifted_pictures(shift, noise=1.0):
    config = RefineConfig()
    images = [picture(4, s, noise=noise) for s in ((0.0, 0.0), shift)]
    depth = np.full(images[0].shape, 3.0, np.float32)
    camera = replace(bw.CAMERA, width=200, height=160)
    frame = Frame(1, 0.1, np.repeat(images[1][..., None], 3, 2), depth, camera)
    return observe(frame), *(prepare_image(image, config) for image in images), \
        surface_image(depth), config


def test_alignment_finds_points_that_start_a_pixel_off():
    shift = np.array([2.3, -1.6])
    b, smooth_a, smooth_b, surface, config = shifted_pictures(tuple(shift))
    uv = lattice((160, 200), step=11)
    n = len(uv)
    matches = PointMatches(uv, np.full(n, 1 / 3), np.full(n, 1e-3), uv, np.repeat(np.eye(2)[None],
                           n, 0), np.zeros(n), np.full(n, np.inf), np.zeros((n, 2)),
                           np.zeros(n, np.int64), np.full(n, CORNER_KIND))
    start = uv + shift + np.random.default_rng(0).uniform(-0.6, 0.6, uv.shape)
    aligned, index = align_points(matches, start, np.repeat(np.eye(2)[None], n, 0), smooth_a,
                                  smooth_b, surface, b, NOISE, config)
    assert len(index) > 0.9 * n
    assert_array_equal(aligned.uv_a, uv[index])
    error = aligned.uv_b - aligned.uv_a - shift
    assert np.median(np.linalg.norm(error, axis=1)) < 0.05
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(aligned.flow_cov), error)
    assert 0.4 < np.median(nees) / 1.386 < 2.5     # the median of χ² with two degrees of freedom
    assert_allclose(aligned.rho_b, 1 / 3, rtol=1e-5)


def edges_picture(offset_px):
    """Two crossing steps of brightness, blurred as a lens does, moved right and down."""
    v, u = np.mgrid[:120, :160].astype(float)
    step = 1 / (1 + np.exp(-((u - 80 - offset_px) + 0.3 * (v - 60)) / 0.5))
    other = 1 / (1 + np.exp(-((v - 60 - offset_px) - 0.2 * (u - 80)) / 0.5))
    return np.rint(60 + 80 * step + 70 * other).astype(np.uint8)


@pytest.mark.parametrize("wrong_px", [-0.8, 0.0, 0.7])
def test_segments_are_aligned_across_their_direction(wrong_px):
    moved = 0.6
    smooth_a, smooth_b = (prepare_image(edges_picture(s), RefineConfig()) for s in (0.0, moved))
    v = np.array([20.0, 50.0])
    one = np.stack([80 - 0.3 * (v - 60), v], axis=-1)                # on the first edge
    u = np.array([90.0, 140.0])
    two = np.stack([u, 60 + 0.2 * (u - 80)], axis=-1)                # on the second
    ends = np.stack([one, two])
    normals = np.array([[1.0, 0.3], [-0.2, 1.0]]) / np.hypot(1, [[0.3], [0.2]])
    lines = LineMatches(ends, np.full((2, 2), 0.3), np.full((2, 2), 1e-3), ends, np.full(2, 0.3),
                        np.zeros(2, np.int64))
    start = ends + wrong_px * normals[:, None]
    aligned, index = align_segments(lines, start, smooth_a, smooth_b)
    assert_array_equal(index, [0, 1])
    across = np.einsum("lpi,li->lp", aligned.endpoints_b - ends, normals)
    expected = moved / np.hypot(1, [0.3, 0.2])
    assert_allclose(across, np.repeat(expected[:, None], 2, 1), atol=0.06)
    assert np.all(aligned.flow_sigma < 0.3)


def test_segments_follow_the_flow_of_the_whole_length(pair):
    camera, box, a, b, flow = pair
    ends = np.array([[[20.0, 12.0], [60.0, 14.0]], [[55.0, 22.0], [95.0, 20.0]]])
    column, row = np.rint(ends).astype(int).transpose(2, 0, 1)
    depth = np.asarray(a.frame.depth_m)[row, column].astype(float)
    segments = Segments2D(ends, depth, np.arange(2), np.zeros(2, np.int32))
    matches, index = follow_segments(segments, np.zeros(2, np.int64), flow, a.label_index,
                                     b.groups({6: 1}), NOISE)
    assert_array_equal(index, [0, 1])
    expected, _ = carried_truly(camera, box, ends.reshape(-1, 2), 1 / depth.ravel(), np.zeros(4))
    assert_allclose(matches.endpoints_b.reshape(-1, 2), expected, atol=0.1)
    assert_allclose(matches.rho_a, 1 / depth)
    gone, index = follow_segments(segments, np.full(2, -1), flow, a.label_index,
                                  b.groups({6: 1}), NOISE)
    assert len(gone) == len(index) == 0


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_straight_shift_along_a_segment_is_fitted_exactly(seed):
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0, 100, (5, 2, 2))
    at_ends = rng.normal(size=(5, 2, 2))
    t = (np.arange(8) + 0.5) / 8
    shift = at_ends[:, None, 0] * (1 - t)[:, None] + at_ends[:, None, 1] * t[:, None]
    weight = rng.uniform(0.5, 2.0, (5, 8)) * (rng.random((5, 8)) < 0.8)
    weight[:, [0, -1]] = 1.0
    moved, _ = fit_endpoints(ends, shift, weight)
    assert_allclose(moved, ends + at_ends, atol=1e-9)
    assert_allclose(sample_positions(ends)[:, [0, -1]].mean(axis=1), ends.mean(axis=1))


def test_fitted_ends_are_as_good_as_they_say():
    rng = np.random.default_rng(0)
    weight = np.full((4000, 8), 1 / 0.3**2)
    ends = np.zeros((4000, 2, 2))
    moved, sigma = fit_endpoints(ends, 0.3 * rng.normal(size=(4000, 8, 2)), weight)
    assert moved.std() == pytest.approx(sigma.mean(), rel=0.05)


SEGMENTS = np.array([[[10.0, 10.0], [60.0, 10.0]], [[10.0, 20.0], [60.0, 25.0]],
                     [[80.0, 5.0], [80.0, 70.0]], [[10.0, 60.0], [50.0, 90.0]]])


@given(st.permutations(range(4)), st.floats(-1.5, 1.5), st.booleans())
@settings(max_examples=30)
def test_segments_are_matched_whatever_their_order_and_direction(order, off_px, turned):
    detected = SEGMENTS[list(order)] + off_px / 1.5
    detected = detected[:, ::-1] if turned else detected
    found = match_segments(SEGMENTS, detected)
    assert_array_equal(found, np.argsort(order))


def test_segments_too_far_or_side_by_side_are_not_matched():
    down = SEGMENTS[:1] + np.array([0.0, 3.0])
    assert_array_equal(match_segments(SEGMENTS[:1], down), [-1])
    beside = SEGMENTS[:1] + np.array([40.0, 0.0])                 # a fifth of the length is shared
    assert_array_equal(match_segments(SEGMENTS[:1], beside), [-1])
    tilted = SEGMENTS[:1] + np.array([[0.0, -3.0], [0.0, 3.0]])
    assert_array_equal(match_segments(SEGMENTS[:1], tilted), [-1])


def test_a_detected_segment_goes_to_the_nearest_carried_one_alone():
    carried = np.repeat(SEGMENTS[:1], 2, 0) + np.array([[[0.0, 1.2]], [[0.0, 0.2]]])
    assert_array_equal(match_segments(carried, SEGMENTS[:1]), [-1, 0])


def test_a_part_of_a_segment_is_that_segment():
    part = np.array([[[30.0, 10.0], [45.0, 10.0]]])
    assert_array_equal(match_segments(SEGMENTS, part), [0, -1, -1, -1])
    assert_array_equal(match_segments(part, SEGMENTS), [0])


def test_nothing_matches_nothing():
    none = np.zeros((0, 2, 2))
    assert len(match_segments(none, SEGMENTS)) == 0
    assert_array_equal(match_segments(SEGMENTS, none), [-1] * 4)
