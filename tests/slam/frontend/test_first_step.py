"""The first step, by features: however large it is, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest

import box_world as bw
from slam.frontend.first_step import find_step
from slam.frontend.observe import observe
from slam.geometry import se3
from slam.systems.sdpl import SdplSlam
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
STEP = se3.exp(np.array([0.01, 0.03, 0.0, 0.1, 0.0, 1.0]))     # to a wall 8 m away


@pytest.fixture(scope="module")
def pair():
    T = bw.hand_held(1)[0]
    box = bw.Box((0.6, 0.5, 0.5), bw.moving(0.2, 0.1, 1.0, 2, (0.0, 0.0, 1.0)))   # rides along
    return bw.sequence(np.stack([T, T @ STEP]), {4: box}, CAMERA, with_flow=False)


def off_m(T):
    return np.linalg.norm((se3.inverse(STEP) @ T)[:3, 3])


def test_a_large_step_is_found_beside_a_thing_that_rides_along(pair):
    assert off_m(find_step(*map(observe, pair), CAMERA)) < 0.05


def test_the_system_starts_from_it(pair):
    system = SdplSlam(CAMERA)
    estimates = [system.process(frame) for frame in pair]
    assert off_m(estimates[1].T_world_camera) < 0.01


@pytest.mark.parametrize("spoil", [
    lambda frame: frame,
    lambda frame: replace(frame, rgb=np.zeros_like(frame.rgb)),
    lambda frame: replace(frame, depth_m=np.zeros_like(frame.depth_m)),
])
def test_where_nothing_moves_or_nothing_is_seen_there_is_no_step(pair, spoil):
    still = observe(spoil(pair[0]))
    np.testing.assert_array_equal(find_step(still, still, CAMERA), np.eye(4))
