"""Segments are found, and culled where they leave their surface."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slam.frontend.segments import cull_segments, detect_segments

SIZE = (200, 300)


def drawing():
    image = np.full(SIZE, 60, np.uint8)
    corners = np.array([[60, 40], [240, 60], [220, 150], [50, 140]], np.int32)
    cv2.fillPoly(image, [corners * 16], 180, cv2.LINE_AA, shift=4)
    return cv2.GaussianBlur(image, (0, 0), 0.8), corners.astype(float)


@pytest.mark.parametrize("detector", ["lsd", "edge_drawing"])
def test_the_sides_of_a_polygon_are_found(detector):
    image, corners = drawing()
    found = detect_segments(image, detector, 40.0)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        normal = np.array([-along[1], along[0]])
        off = np.abs((found - a) @ normal).max(axis=1)
        length = np.abs((found[:, 1] - found[:, 0]) @ along)
        assert length[off < 1.0].max() > 0.85 * np.linalg.norm(b - a)


@pytest.mark.parametrize("detector", ["lsd", "edge_drawing"])
def test_minimum_length_and_blank_images(detector):
    found = detect_segments(drawing()[0], detector, 120.0)
    assert len(found) > 0
    assert (np.linalg.norm(found[:, 1] - found[:, 0], axis=-1) >= 120.0).all()
    for grey in (0, 255):
        assert detect_segments(np.full(SIZE, grey, np.uint8), detector).shape == (0, 2, 2)


def test_unknown_detector():
    with pytest.raises(ValueError, match="there are lsd, edge_drawing"):
        detect_segments(np.zeros(SIZE, np.uint8), "hough")


def plane(a, b, c):
    """Depth of a plane: 1/z = a u + b v + c."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    return (1.0 / (a * u + b * v + c)).astype(np.float32)


def test_depth_of_ends_is_that_of_the_plane_despite_noise():
    clean = plane(4e-4, -2e-4, 0.25)
    rng = np.random.default_rng(0)
    noisy = clean + 0.002 * clean ** 2 * rng.normal(size=SIZE)
    noisy[rng.random(SIZE) < 0.03] = 0.0
    segments = rng.uniform([20, 20], [280, 180], (60, 2, 2))
    segments = segments[np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1) > 30]
    kept, label, depth = cull_segments(segments, noisy)
    true = clean[tuple(np.rint(segments).astype(int).transpose(2, 0, 1)[::-1])]
    assert kept.mean() > 0.95
    assert (label == 0).all()
    error = (depth - true)[kept] / true[kept] ** 2
    assert np.sqrt((error ** 2).mean()) < 0.0015       # less than one pixel's noise


def test_a_step_along_the_segment_culls_it():
    depth = np.where(np.arange(300) < 150, 2.0, 3.0).astype(np.float32) * np.ones((200, 1))
    segments = np.array([[[100.0, 50], [200, 60]],      # across the step
                         [[20.0, 50], [140, 90]],       # on the near side
                         [[170.0, 150], [280, 20]]])    # on the far side
    kept, _, ends = cull_segments(segments, depth.astype(np.float32))
    assert kept.tolist() == [False, True, True]
    np.testing.assert_allclose(ends, [[0, 0], [2, 2], [3, 3]])


def test_a_border_belongs_to_the_nearer_surface():
    depth = plane(0, 0, 0.2)
    labels = np.zeros(SIZE, np.int32)
    depth[50:150, 100:200], labels[50:150, 100:200] = 2.0, 5
    just_outside = np.array([[[99.4, 60.0], [99.4, 140.0]], [[110, 149.6], [190, 149.6]]])
    kept, label, ends = cull_segments(just_outside, depth, labels)
    assert kept.all()
    assert label.tolist() == [5, 5]
    np.testing.assert_allclose(ends, 2.0)


def test_masks_that_differ_at_the_ends_cull():
    depth = np.full(SIZE, 4.0, np.float32)
    labels = np.zeros(SIZE, np.int32)
    labels[:, 150:] = 3
    segments = np.array([[[100.0, 50], [200, 60]], [[160.0, 20], [280, 150]]])
    kept, label, _ = cull_segments(segments, depth, labels)
    assert kept.tolist() == [False, True]
    assert label.tolist() == [0, 3]


def test_no_depth_no_segments():
    segments = np.array([[[100.0, 50], [200, 60]]])
    assert not cull_segments(segments, np.zeros(SIZE, np.float32))[0].any()
    kept, label, depth = cull_segments(np.zeros((0, 2, 2)), np.ones(SIZE, np.float32))
    assert kept.shape == (0,)
    assert label.shape == (0,)
    assert depth.shape == (0, 2)
