"""Dense flow: estimated, predicted, sampled."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slam.frontend.flow import (
    DisFlow,
    local_warps,
    predicted_flow,
    round_trip_error,
    sample_flow,
    warp_back,
)
from slam.geometry import se3
from slam.types import FlowField, Intrinsics
from wave_pictures import lattice, picture

CAMERA = Intrinsics(200.0, 210.0, 99.5, 79.5, 200, 160)


def test_dis_finds_a_shift_with_and_without_prediction():
    previous, current = picture(), picture(shift=(3.3, -1.6))
    uv = lattice(previous.shape, margin=25)
    flow = DisFlow("medium")
    plain = sample_flow(flow(previous, current), uv)[0]
    assert np.median(np.linalg.norm(plain - [3.3, -1.6], axis=-1)) < 0.15
    predicted = np.full((*previous.shape, 2), (3.0, -1.5), np.float32)
    rest = sample_flow(flow(previous, current, predicted), uv)[0]
    assert np.median(np.linalg.norm(rest - [3.3, -1.6], axis=-1)) < 0.15


def test_a_prediction_reaches_what_plain_search_cannot():
    previous, current = picture(), picture(shift=(31.0, 17.0))
    predicted = np.full((*previous.shape, 2), (30.6, 17.3), np.float32)
    uv = lattice(previous.shape, margin=45)
    rest = sample_flow(DisFlow("medium")(previous, current, predicted), uv)[0]
    assert np.median(np.linalg.norm(rest - [31.0, 17.0], axis=-1)) < 0.2


def test_dis_does_not_depend_on_threads():
    previous, current = picture(noise=2.0), picture(shift=(2.3, 1.1), noise=2.0)
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        one = DisFlow("fast")(previous, current).flow_px
        cv2.setNumThreads(2)
        two = DisFlow("fast")(previous, current).flow_px
    finally:
        cv2.setNumThreads(before)
    assert_array_equal(one, two)


@pytest.mark.parametrize("preset", ["ultrafast", "fast", "medium"])
@pytest.mark.parametrize("size", [(1, 1), (11, 11), (15, 46), (12, 640), (20, 1000), (1000, 7)])
def test_dis_takes_pictures_too_small_for_its_scales(preset, size):
    picture_of = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    flow = DisFlow(preset)
    still = flow(picture_of, picture_of, np.zeros((*size, 2), np.float32))
    assert still.flow_px.shape == (*size, 2)
    assert_allclose(flow(picture_of, picture_of).flow_px, 0.0, atol=0.02)


def test_small_pictures_leave_the_others_as_opencv_has_them():
    previous, current = picture(), picture(shift=(3.3, -1.6))
    flow = DisFlow("medium")
    flow(previous[:9, :9], current[:9, :9])
    usual = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    for height, width in ((160, 200), (16, 46), (46, 16)):
        before, after = (np.ascontiguousarray(image[:height, :width])
                         for image in (previous, current))
        assert_array_equal(flow(before, after).flow_px, usual.calc(before, after, None))


def test_dis_finds_the_shift_of_a_small_picture():
    """What is seen of 40 x 11 pixels moves as the whole picture does."""
    small = [image[40:51, 40:80] for image in (picture(), picture(shift=(1.3, -0.6)))]
    found = DisFlow("medium")(*map(np.ascontiguousarray, small)).flow_px
    assert np.linalg.norm(np.median(found[2:-2, 4:-4], axis=(0, 1)) - [1.3, -0.6]) < 0.3


def test_unknown_preset():
    with pytest.raises(ValueError, match="there are ultrafast, fast, medium"):
        DisFlow("slow")


def test_warp_back_undoes_a_shift():
    previous, current = picture(), picture(shift=(4.0, 2.0))
    warped, landed = warp_back(current, np.full((160, 200, 2), (4.0, 2.0), np.float32))
    assert landed[:-2, :-4].all()
    assert not landed[:, -4:].any()
    assert np.abs(warped[landed].astype(int) - previous[landed]).max() <= 1


def test_predicted_flow_is_the_projection_of_moved_points():
    rng = np.random.default_rng(0)
    depth = rng.uniform(1.0, 6.0, (160, 200)).astype(np.float32)
    depth[:5] = 0.0
    labels = np.zeros((160, 200), np.uint8)
    labels[50:90, 60:120] = 4
    T = se3.exp(np.array([0.02, -0.01, 0.03, 0.1, -0.05, 0.08]))
    G = se3.exp(np.array([-0.1, 0.05, 0.02, 0.0, 0.1, -0.2]))
    flow = predicted_flow(depth, labels, T, {4: G}, CAMERA)
    v, u = np.mgrid[:160, :200].astype(float)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], -1)
    xyz = rays * depth[..., None]
    for motion, label in ((T, 0), (G, 4)):
        mine = (labels == label) & (depth > 0)
        moved = se3.transform_points(motion, xyz[mine])
        expected = moved[:, :2] / moved[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
        assert_allclose(flow[mine], expected - np.stack([u[mine], v[mine]], -1), atol=2e-4)
    # Without depth a pixel turns as if infinitely far.
    far = se3.transform_points(se3.from_rotation_translation(T[:3, :3], np.zeros(3)), rays[0])
    expected = far[:, :2] / far[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    assert_allclose(flow[0], expected - np.stack([u[0], v[0]], -1), atol=2e-4)


def test_local_warps_are_the_flow_s_slope():
    v, u = np.mgrid[:60, :80].astype(np.float32)
    A = np.array([[1.03, -0.1], [0.08, 0.97]])
    flow = np.stack([u, v], -1) @ (A - np.eye(2)).T
    assert_allclose(local_warps(flow, np.array([[40.3, 30.2], [20.0, 20.0]])), [A, A], atol=1e-6)


def test_sampling_never_mixes_instances_or_invalid_flow():
    flow = np.zeros((10, 12, 2), np.float32)
    labels = np.zeros((10, 12), np.int32)
    labels[:, 6:] = 1
    flow[:, 6:] = (8.0, 4.0)
    uv = np.array([[5.3, 4.4], [5.6, 4.4]])
    mixed, _ = sample_flow(FlowField(flow), uv)
    assert 0 < mixed[0, 0] < 8
    apart, known = sample_flow(FlowField(flow), uv, labels)
    assert_allclose(apart, [[0, 0], [8, 4]])
    assert known.all()
    valid = np.ones((10, 12), bool)
    valid[:, 6:] = False
    kept, known = sample_flow(FlowField(flow, valid), uv)
    assert_allclose(kept[0], [0, 0])
    assert known.tolist() == [True, False]
    flow[4, 5] = np.nan
    got, known = sample_flow(FlowField(flow), np.array([[5.3, 4.4], [4.6, 3.4], [-1.0, 2.0]]))
    assert known.tolist() == [False, True, False]
    assert np.isfinite(got).all()


def test_round_trip():
    there = FlowField(np.full((30, 40, 2), (2.0, 1.0), np.float32))
    back = FlowField(np.full((30, 40, 2), (-2.0, -0.7), np.float32))
    uv = np.array([[10.0, 10.0], [39.0, 10.0]])
    assert_allclose(round_trip_error(there, back, uv), [0.3, np.inf], atol=1e-6)
