"""Segments described as cv2's LBD describes them, sooner."""

import cv2
import numpy as np

from slam.dpl.config import LineConfig
from slam.dpl.lbd import describe_lines
from slam.dpl.lines import LineDetector


def picture(seed: int = 0, height: int = 240, width: int = 320) -> np.ndarray:
    """Blocks of all sizes, a little blurred: corners and straight edges."""
    rng = np.random.default_rng(seed)
    gray = np.full((height, width), 120, np.uint8)
    for _ in range(60):
        u, v = rng.integers(0, width), rng.integers(0, height)
        turned = ((float(u), float(v)), tuple(rng.uniform(15, 90, 2)), float(rng.uniform(0, 90)))
        cv2.fillPoly(gray, [cv2.boxPoints(turned).astype(np.int32)], int(rng.integers(20, 235)))
    return cv2.GaussianBlur(gray, (0, 0), 0.8)


def test_descriptors_of_lines_are_those_of_cv2():
    gray = picture(1)
    lines = LineDetector(LineConfig())(gray)
    kept, theirs = cv2.line_descriptor.BinaryDescriptor_createBinaryDescriptor().compute(
        gray, [_cv_line(i, row) for i, row in enumerate(lines.ends_px.reshape(-1, 4).tolist())])
    assert len(kept) == len(lines) > 20
    bits = np.unpackbits(lines.descriptor ^ theirs, axis=1).sum(axis=1)
    assert bits.mean() < 1.0
    assert bits.max() <= 8


def test_descriptors_of_lines_tell_a_line_from_its_reverse_and_from_others():
    gray = picture(1)
    ends = LineDetector(LineConfig())(gray).ends_px
    ahead, back = describe_lines(gray, ends), describe_lines(gray, ends[:, ::-1])
    apart = np.unpackbits(ahead ^ back, axis=1).sum(axis=1)
    others = np.unpackbits(ahead[1:] ^ ahead[:-1], axis=1).sum(axis=1)
    assert np.median(apart) > 40
    assert np.median(others) > 40


def test_a_line_of_no_length_and_a_plain_picture_are_described():
    gray, ends = np.full((40, 50), 9, np.uint8), np.array([[[5.0, 5.0], [5.0, 5.0]]])
    assert not describe_lines(gray, ends).any()
    assert describe_lines(picture(), ends).shape == (1, 32)


def _cv_line(number: int, row: list[float]) -> cv2.line_descriptor.KeyLine:
    u0, v0, u1, v1 = row
    line = cv2.line_descriptor.KeyLine()
    line.class_id, line.octave = number, 0
    line.startPointX = line.sPointInOctaveX = u0
    line.startPointY = line.sPointInOctaveY = v0
    line.endPointX = line.ePointInOctaveX = u1
    line.endPointY = line.ePointInOctaveY = v1
    line.angle = float(np.arctan2(v1 - v0, u1 - u0))
    line.lineLength = float(np.hypot(u1 - u0, v1 - v0))
    line.numOfPixels = int(max(abs(u1 - u0), abs(v1 - v0))) + 1
    return line
