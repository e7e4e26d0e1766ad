"""Depth from a rectified pair by matching points and lines, and pairs that are none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import slam
from slam.dpl.config import DplConfig
from slam.dpl.features import Features, KeyLines
from slam.dpl.lines import LineDetector
from slam.dpl.orb import OrbDetector
from slam.dpl.stereo import StereoMatcher, fault_of_pair, with_stereo_depth
from slam.dpl.stereo_lines import line_disparities, match_line_pairs, row_overlap
from slam.frontend.refine import prepare_image
from slam.types import Frame, Intrinsics, Status

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240, baseline_m=0.2)
K = CAMERA.fx * CAMERA.baseline_m
CONFIG = DplConfig()
DISPARITY = 13.4


def wall(seed=0):
    """(240, 400) grey: blurred noise with dark and bright bars at an angle."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.uniform(0, 255, (240, 400)).astype(np.float32), (0, 0), 1.5)
    image = cv2.normalize(noise, None, 60, 190, cv2.NORM_MINMAX)
    for u in range(40, 400, 60):
        cv2.line(image, (u, 20), (u + 45, 220), 250.0 if u % 120 else 5.0, 7, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


def pair(rows_px=0.0, seed=0):
    """Left and right (240, 320) uint8 of a wall at depth K / DISPARITY."""
    def shifted(u, v):
        M = np.array([[1.0, 0.0, -u], [0.0, 1.0, v]])
        seen = cv2.warpAffine(wall(seed), M, (320, 240), flags=cv2.INTER_CUBIC,
                              borderMode=cv2.BORDER_REPLICATE)
        return np.clip(np.rint(seen), 0, 255).astype(np.uint8)
    return shifted(20.0, 0.0), shifted(20.0 + DISPARITY, rows_px)


def features(gray):
    return Features(OrbDetector(CONFIG.orb)(gray), LineDetector(CONFIG.lines)(gray))


def test_points_get_their_depth_to_a_fraction_of_a_pixel():
    left, right = pair()
    found = with_stereo_depth(features(left), features(right), prepare_image(left),
                              prepare_image(right), CAMERA, CONFIG.stereo, CONFIG.orb.scale)
    depth = found.points.depth_m
    assert np.mean(depth > 0) > 0.4
    error_px = K / depth[depth > 0] - DISPARITY
    assert np.median(np.abs(error_px)) < 0.1
    assert np.mean(np.abs(error_px) < 0.5) > 0.95
    assert (found.points.whitening[depth > 0, 3] > 0).all()     # 1/σ of the inverse depth
    assert (found.points.whitening[depth == 0, 3] == 0).all()


def test_lines_get_the_depth_of_both_ends():
    left, right = pair()
    found = with_stereo_depth(features(left), features(right), prepare_image(left),
                              prepare_image(right), CAMERA, CONFIG.stereo, CONFIG.orb.scale)
    depth = found.lines.depth_m[(found.lines.depth_m > 0).all(axis=1)]
    assert len(depth) >= 5
    assert np.median(np.abs(K / depth - DISPARITY)) < 0.5


def lines_at(ends, bits=0):
    descriptor = np.full((len(ends), 32), bits, np.uint8)
    return KeyLines(np.asarray(ends, float), descriptor, np.zeros((len(ends), 2)))


UPRIGHT = [[100.0, 50.0], [104.0, 150.0]]


@pytest.mark.parametrize(("other", "partner"), [
    ([[90.0, 51.0], [94.0, 150.0]], 0),           # 10 px of disparity
    ([[90.0, 51.0], [94.0, 90.0]], 0),            # broken off, but within the other's rows
    ([[90.0, 130.0], [94.0, 230.0]], -1),         # neither end in the other's cell
    ([[110.0, 51.0], [114.0, 150.0]], -1),        # farther right in the right picture
    ([[90.0, 51.0], [170.0, 150.0]], -1),         # runs another way
])
def test_lines_that_may_be_partners(other, partner):
    found = match_line_pairs(lines_at([UPRIGHT]), lines_at([other]), CONFIG.stereo, (240, 320))
    assert_array_equal(found, [partner])


def test_of_two_lines_the_one_that_looks_alike_both_ways():
    left = lines_at([UPRIGHT])
    right = KeyLines(np.array([[[90.0, 51.0], [94.0, 150.0]], [[80.0, 51.0], [84.0, 150.0]]]),
                     np.array([[3] * 32, [0] * 32], np.uint8), np.zeros((2, 2)))
    assert_array_equal(match_line_pairs(left, right, CONFIG.stereo, (240, 320)), [1])
    assert_array_equal(match_line_pairs(left, lines_at([UPRIGHT], 255), CONFIG.stereo, (240, 320)),
                       [-1])


def test_the_disparity_of_ends_is_read_in_their_own_rows():
    left = np.array([UPRIGHT, [[0.0, 40.0], [90.0, 41.0]]])
    right = np.array([[[90.0, 30.0], [99.0, 180.0]]])
    found = line_disparities(left, right, np.array([0, 0]))
    assert_allclose(found[0], [100.0 - (90.0 + 9.0 * 20 / 150), 104.0 - (90.0 + 9.0 * 120 / 150)])
    assert_array_equal(found[1], 0.0)             # along a row there is none
    assert_array_equal(line_disparities(left, right, np.array([-1, -1])), 0.0)
    assert_allclose(row_overlap(left[:1], right), 1.0)


def test_a_pair_that_is_swapped_or_not_rectified_is_named():
    left, right = (OrbDetector(CONFIG.orb)(image) for image in pair())
    assert fault_of_pair(left, right, CONFIG.stereo) == ""
    assert "swapped" in fault_of_pair(right, left, CONFIG.stereo)
    crooked = OrbDetector(CONFIG.orb)(pair(rows_px=6.0)[1])
    assert "6.0 px apart" in fault_of_pair(left, crooked, CONFIG.stereo)
    nothing = OrbDetector(CONFIG.orb)(np.zeros((240, 320), np.uint8))
    assert fault_of_pair(left, nothing, CONFIG.stereo) == ""


def test_a_fault_is_warned_of_once_and_gives_no_depth(caplog):
    left, right = pair()
    match = StereoMatcher(CAMERA, CONFIG.stereo, CONFIG.orb.scale)
    for _ in range(2):
        found = match(features(right), features(left), prepare_image(right), prepare_image(left))
        assert not found.points.depth_m.any()
        assert "swapped" in match.fault
    assert len(caplog.records) == 1


def frame(index, left, right):
    rgb = [cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) for image in (left, right)]
    return Frame(index, 0.1 * index, rgb[0], np.zeros(left.shape, np.float32), CAMERA,
                 right=rgb[1])


def test_the_system_matches_pairs_that_come_without_depth():
    system = slam.make("dpl", CAMERA)
    first, second = (system.process(frame(k, *pair())) for k in range(2))
    assert first.status is Status.FIRST
    assert second.status is Status.TRACKED
    points = system.finish().points_world
    assert_allclose(np.median(points[:, 2]), K / DISPARITY, rtol=0.02)


def test_the_system_says_what_is_wrong_with_a_pair():
    system = slam.make("dpl", CAMERA)
    estimate = system.process(frame(0, *pair()[::-1]))
    assert estimate.status is Status.LOST
    assert "left and right are swapped" in estimate.reason


def test_a_pair_s_fault_is_no_matter_of_the_frame_after_it():
    system = slam.make("dpl", CAMERA)
    swapped, alone = frame(0, *pair()[::-1]), replace(frame(1, *pair()), right=None)
    assert "swapped" in system.process(swapped).reason
    assert "swapped" not in system.process(alone).reason
