"""Points as cv2's own ORB finds and describes them, sooner."""

import cv2
import numpy as np
import pytest

from slam.dpl.config import LineConfig, OrbConfig
from slam.dpl.fast import PADDING_PX, FastDetector, best
from slam.dpl.lines import LineDetector
from slam.dpl.orb import OrbDetector, angles_deg, pyramid

CONFIG = OrbConfig(count=200)


def picture(seed: int = 0, height: int = 240, width: int = 320) -> np.ndarray:
    """Blocks of all sizes, a little blurred: corners and straight edges."""
    rng = np.random.default_rng(seed)
    gray = np.full((height, width), 120, np.uint8)
    for _ in range(60):
        u, v = rng.integers(0, width), rng.integers(0, height)
        turned = ((float(u), float(v)), tuple(rng.uniform(15, 90, 2)), float(rng.uniform(0, 90)))
        cv2.fillPoly(gray, [cv2.boxPoints(turned).astype(np.int32)], int(rng.integers(20, 235)))
    return cv2.GaussianBlur(gray, (0, 0), 0.8)


def of_cv2(gray: np.ndarray) -> tuple[dict, np.ndarray]:
    """Response and angle of cv2's ORB points by place and level, and those of descriptors."""
    orb = cv2.ORB_create(nfeatures=3 * CONFIG.count, scaleFactor=CONFIG.scale,
                         nlevels=CONFIG.levels, fastThreshold=CONFIG.fast_threshold,
                         edgeThreshold=12)
    points, descriptor = orb.compute(gray, orb.detect(gray))
    return {(round(p.pt[0], 2), round(p.pt[1], 2), p.octave): (p.angle, d)
            for p, d in zip(points, descriptor, strict=True)}


def test_points_are_among_those_of_cv2_with_their_angles_and_descriptors():
    gray = picture()
    found, theirs = OrbDetector(CONFIG)(gray), of_cv2(gray)
    keys = [(round(u, 2), round(v, 2), int(level))
            for (u, v), level in zip(found.uv_px, found.level, strict=True)]
    known = [i for i, key in enumerate(keys) if key in theirs]
    assert len(found) > 150
    assert len(known) >= 0.98 * len(found)
    angles, descriptors = zip(*(theirs[keys[i]] for i in known), strict=True)
    gap = np.abs((found.angle_deg[known] - angles + 180.0) % 360.0 - 180.0)
    assert gap.max() < 0.02                  # cv2's arc tangent is a polynomial
    bits = np.unpackbits(found.descriptor[known] ^ np.array(descriptors), axis=1).sum(axis=1)
    assert np.mean(bits > 0) < 0.05
    assert bits.max() <= 4


def test_points_do_not_depend_on_the_pictures_before():
    fresh, used = OrbDetector(CONFIG), OrbDetector(CONFIG)
    for seed in (3, 4):
        used(picture(seed))
    used(np.full((240, 320), 90, np.uint8))
    used(cv2.equalizeHist(picture(5)))       # of high contrast: the thresholds rise
    a, b = fresh(picture()), used(picture())
    assert np.array_equal(a.uv_px, b.uv_px)
    assert np.array_equal(a.descriptor, b.descriptor)


def test_thresholds_rise_where_there_are_many_corners_and_fall_again():
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    detector, few = FastDetector(CONFIG, 50), []
    for gray in (noise, noise, picture(), picture()):
        padded = [cv2.copyMakeBorder(gray, *(4 * [PADDING_PX]), cv2.BORDER_REFLECT_101)]
        detector(padded)
        few.append(detector._thresholds[0])
    assert few[0] > 3 * CONFIG.fast_threshold
    assert few[3] < few[1]


@pytest.mark.parametrize("shape", [(240, 320), (25, 30), (1, 1)])
def test_a_plain_or_tiny_picture_has_no_points_and_no_lines(shape):
    gray = np.full(shape, 128, np.uint8)
    assert len(OrbDetector(CONFIG)(gray)) == 0
    assert len(LineDetector(LineConfig())(gray)) == 0


def test_every_level_is_made_of_the_one_before():
    levels = pyramid(picture(), 8, 1.2)
    assert [image.shape for image in levels[:3]] == [(240, 320), (200, 267), (167, 222)]
    assert len(levels) == 8


def test_an_angle_points_to_the_brighter_side():
    ramp = np.tile(np.arange(0, 200, dtype=np.uint8), (60, 1))
    at = np.array([[60, 30]])
    assert angles_deg(ramp, at)[0] == pytest.approx(0.0, abs=1e-9)
    assert angles_deg(np.ascontiguousarray(ramp.T), at[:, ::-1])[0] == pytest.approx(90.0)


def test_best_keeps_those_that_equal_the_last():
    assert best(np.array([3.0, 1.0, 2.0, 2.0, 5.0]), 3).tolist() == [0, 2, 3, 4]
    assert best(np.array([3.0, 1.0]), 5).tolist() == [0, 1]
    assert best(np.array([3.0, 1.0]), 0).tolist() == []
