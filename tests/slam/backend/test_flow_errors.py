"""Flow whose noise belongs to places is told from flow with noise of its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from slam.backend.flow_errors import SuccessiveErrors
from slam.backend.step_errors import MOST_CORRELATION
from slam.frontend.observe import Observation, observe
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, Intrinsics

SHAPE = 240, 320
CAMERA = Intrinsics(300.0, 300.0, 160.0, 120.0, SHAPE[1], SHAPE[0])
# Three pixels to the left on a wall 3 m away.
STEP = np.eye(4) + np.pad([[0.0, 0.0, 0.0, -0.03], [0.0] * 4, [0.0] * 4], ((0, 1), (0, 0)))


def wall(depth_m: float = 3.0) -> Observation:
    return observe(Frame(index=0, stamp_s=0.0, rgb=np.zeros((*SHAPE, 3), np.uint8),
                         depth_m=np.full(SHAPE, depth_m, np.float32), intrinsics=CAMERA))


def field(error: Array) -> FlowField:
    flow = np.zeros((*SHAPE, 2), np.float32)
    flow[..., 0] = -3.0
    return FlowField((flow + error).astype(np.float32))


def measured(errors: list[Array]) -> SuccessiveErrors:
    out, before = SuccessiveErrors(CAMERA), wall()
    for error in errors:
        out.take_in(field(error), before, STEP)
    return out


def test_noise_of_places_enters_neighbouring_fields_with_opposite_signs():
    rng = np.random.default_rng(0)
    places = [rng.normal(size=(*SHAPE, 2), scale=0.2) for _ in range(5)]
    errors = [np.roll(b, 3, axis=1) - a for a, b in pairwise(places)]
    assert measured(errors).correlation == -MOST_CORRELATION


def test_noise_of_each_field_does_not_hang_together():
    rng = np.random.default_rng(1)
    fields = [rng.normal(size=(*SHAPE, 2), scale=0.2) for _ in range(4)]
    assert measured(fields).correlation == pytest.approx(0.0, abs=0.04)


def test_nothing_is_measured_across_an_interruption():
    rng = np.random.default_rng(2)
    out, before = SuccessiveErrors(CAMERA), wall()
    for _ in range(3):
        out.take_in(field(rng.normal(size=(*SHAPE, 2))), before, STEP)
        out.interrupted()
    assert out.correlation == 0.0


def test_a_field_that_nothing_can_be_held_against_tells_nothing():
    out = SuccessiveErrors(CAMERA)
    for _ in range(2):
        out.take_in(field(np.zeros((*SHAPE, 2))), wall(0.0), STEP)
    assert out.correlation == 0.0
