"""Detections: exact around their masks, and wrong as often as the noise says."""

import numpy as np
import pytest

from simbench.errors import UserError
from simbench.sensors.boxes import BoxNoise, box_noise, boxes_of_masks, class_number
from slam.dynamics.detection import UNKNOWN_CLASS
from slam.types import Boxes2D

SIZE = (480, 640)
QUIET = BoxNoise(missed=0.0, late=0.0, jitter=0.0, false_a_frame=0.0, confused=0.0,
                 smallest_px=0.0)


def boxes(count: int = 400) -> Boxes2D:
    corners = np.tile([100.0, 200.0, 199.0, 249.0], (count, 1))
    return Boxes2D(corners, np.ones(count), np.full(count, 2))


def noisy(seed: int = 0, **changed: float) -> Boxes2D:
    values = {name: getattr(QUIET, name) for name in QUIET.__slots__} | changed
    return box_noise(boxes(), BoxNoise(**values), SIZE, np.random.default_rng(seed))


def test_boxes_stand_around_their_masks_and_bear_their_class():
    masks = np.zeros(SIZE, np.int32)
    masks[20:60, 30:50] = 4
    masks[100:101, 600:640] = 9
    np.testing.assert_array_equal(boxes_of_masks(masks).corners_px,
                                  [[30, 20, 49, 59], [600, 100, 639, 100]])
    assert boxes_of_masks(masks).label.tolist() == [UNKNOWN_CLASS] * 2
    known = boxes_of_masks(masks, {9: class_number("person")})
    assert known.label.tolist() == [0]
    assert known.corners_px[0, 0] == 600
    assert boxes_of_masks(np.zeros(SIZE, np.int32)).corners_px.shape == (0, 4)
    assert class_number("kicked box") == UNKNOWN_CLASS


def test_without_noise_boxes_stay_and_only_doubt_comes():
    found = noisy()
    np.testing.assert_array_equal(found.corners_px, boxes().corners_px)
    assert ((found.score > 0.5) & (found.score <= 1.0)).all()


def test_each_fault_is_as_frequent_as_it_says():
    # Bounds are four standard deviations of the binomial or Poisson count.
    assert abs(400 - len(noisy(missed=0.3).score) - 120) < 4 * np.sqrt(400 * 0.3 * 0.7)
    assert abs(np.count_nonzero(noisy(confused=0.2).label != 2) - 79) < 4 * np.sqrt(400 * 0.16)
    assert abs(len(noisy(false_a_frame=100.0).score) - 500) < 4 * np.sqrt(100)
    spread = (noisy(jitter=0.05).corners_px - boxes().corners_px).std(axis=0)
    np.testing.assert_allclose(spread, [5.0, 2.5, 5.0, 2.5], rtol=4 / np.sqrt(800))
    assert len(noisy(smallest_px=100.0).score) == 0


def test_boxes_stay_in_the_image_with_their_corners_in_order():
    corners = noisy(jitter=1.0, false_a_frame=50.0).corners_px
    assert (corners >= 0).all()
    assert (corners <= [639, 479, 639, 479]).all()
    assert (corners[:, :2] <= corners[:, 2:]).all()


@pytest.mark.parametrize(("name", "value"), [("missed", 1.5), ("jitter", -0.1),
                                             ("false_a_frame", -1.0), ("late", float("nan"))])
def test_impossible_noise_is_refused(name, value):
    with pytest.raises(UserError, match=name):
        BoxNoise(**{name: value})
