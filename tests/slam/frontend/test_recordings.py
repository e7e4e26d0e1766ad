"""The front end on real recordings; skipped where they are not at hand."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.frontend.flow import DisFlow, round_trip_error, sample_flow
from slam.frontend.points import corner_response, detect_points
from slam.frontend.refine import prepare_image, refine_matches
from slam.frontend.segments import cull_segments, detect_segments
from slam.frontend.stereo import depth_from_stereo
from slam.types import Intrinsics

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
TRACKING, ODOMETRY = DATA / "kitti_tracking_0003", DATA / "kitti_odometry_06"


def gray(path):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return image


@pytest.fixture(scope="module")
def street():
    if not TRACKING.is_dir():
        pytest.skip(f"{TRACKING} is not there")
    images = [gray(TRACKING / "image_0" / f"{k:06d}.png") for k in (10, 11)]
    labels = np.loadtxt(TRACKING / "semantic" / "000010.txt").astype(np.int32)
    return *images, labels


def test_refinement_agrees_with_itself_there_and_back(street):
    previous, current, labels = street
    uv, _ = detect_points(corner_response(previous), 1200, labels)
    assert len(uv) > 1000
    assert (labels[uv[:, 1].astype(int), uv[:, 0].astype(int)] > 0).sum() > 200
    flow = DisFlow("fast")
    forward, backward = flow(previous, current), flow(current, previous)
    good = round_trip_error(forward, backward, uv) < 1.0
    uv = uv[good]
    start, _ = sample_flow(forward, uv, labels)
    a, b = prepare_image(previous), prepare_image(current)
    there = refine_matches(a, b, uv, uv + start)
    rng = np.random.default_rng(0)
    back = refine_matches(b, a, there.uv_current, uv + rng.normal(0, 0.2, uv.shape))
    both = there.converged & back.converged
    assert both.mean() > 0.8
    gap = np.linalg.norm(back.uv_current - uv, axis=-1)[both]
    rough = np.linalg.norm(there.uv_current - uv - start, axis=-1)[both]
    assert np.median(gap) < 0.03
    assert np.median(gap) < 0.3 * np.median(rough)


def test_segments_of_a_street(street):
    image, _, labels = street
    disparity = cv2.imread(str(TRACKING / "depth" / "000010.png"), cv2.IMREAD_UNCHANGED) / 256.0
    depth = np.where(disparity > 1, 380.0 / np.maximum(disparity, 1), 0).astype(np.float32)
    found = detect_segments(image, "edge_drawing")
    kept, label, ends = cull_segments(found, depth, labels)
    assert kept.sum() > 100
    assert (label[kept] > 0).sum() > 20
    assert (ends[kept] > 0).all()
    assert (ends[~kept] == 0).all()


def test_stereo_depth_of_a_street():
    if not ODOMETRY.is_dir():
        pytest.skip(f"{ODOMETRY} is not there")
    left, right = (gray(sorted((ODOMETRY / side).glob("*.png"))[0])
                   for side in ("image_0", "image_1"))
    height, width = left.shape
    camera = Intrinsics(707.1, 707.1, 601.9, 183.1, width, height, baseline_m=0.537)
    depth = depth_from_stereo(left, right, camera)
    assert (depth > 0).mean() > 0.5
    road = depth[height - 30:height - 10, width // 2 - 150:width // 2 + 150]
    assert 4.0 < np.median(road[road > 0]) < 12.0
