"""An offset of all inverse depths: learnt from the steps, and taken out of the map."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import box_world as bw
import slam
from slam.dpl.calibrate import DepthCalibration
from slam.dpl.features import Features, no_lines, no_points
from slam.dpl.keyframes import PointLineMap
from slam.dpl.memory import LandmarkMemory
from slam.dpl.recalibrate import recalibrate
from slam.estimation.calibration import DepthOffset, shifted_depth
from slam.geometry import se3
from slam.geometry.camera import back_project, project
from slam.systems.registry import default_config
from slam.types import Intrinsics, Status

CAMERA = Intrinsics(170.0, 170.0, 159.5, 119.5, 320, 240)
FRAMES = 12
LARGER = 10.0            # the room as large as a square: there parallax tells depth from its offset


@pytest.fixture(scope="module")
def drive():
    """A camera that drives forward and a little sideways through a large room, with exact depth."""
    way = np.zeros((FRAMES, 6))
    way[:, 3], way[:, 5] = 0.03 * np.arange(FRAMES), 0.1 * np.arange(FRAMES) - 4.5
    camera = se3.exp(way)
    pictures = [bw.render(T, {}, CAMERA) for T in camera]
    camera[:, :3, 3] *= LARGER
    return camera, [bw.Frame(k, 0.1 * k, np.rint(p.rgb).astype(np.uint8),
                             (LARGER * p.depth_m).astype(np.float32), CAMERA)
                    for k, p in enumerate(pictures)]


def run(frames, offset, **depth):
    """A system after frames whose inverse depths were made smaller by an offset, 1/m."""
    config = default_config("orb")
    system = slam.make("orb", CAMERA, replace(config, depth=replace(config.depth, **depth)))
    rng = np.random.default_rng(3)
    estimates = []
    for frame in frames:
        noise = 0.0002 * rng.normal(size=frame.depth_m.shape)
        rho = 1.0 / frame.depth_m - offset + noise
        estimates.append(system.process(replace(frame, depth_m=(1.0 / rho).astype(np.float32))))
    return system, estimates


def way_m(estimates):
    return np.linalg.norm(estimates[-1].T_world_camera[:3, 3])


@pytest.mark.parametrize("offset", [0.004, -0.004])
def test_an_offset_is_learnt_and_steps_become_as_long_as_they_are(drive, offset):
    camera, frames = drive
    system, estimates = run(frames, offset)
    assert {e.status for e in estimates[1:]} == {Status.TRACKED}
    learnt = system.calibration.learnt
    assert abs(learnt.mean - offset) < 4.0 * learnt.sigma
    assert abs(system.calibration.applied - offset) < 0.05 * abs(offset)
    true = np.linalg.norm(camera[-1, :3, 3] - camera[0, :3, 3])
    without = way_m(run(frames, offset, learn_depth_offset=False)[1])
    assert abs(way_m(estimates) - true) < 0.3 * abs(without - true)


def test_where_there_is_none_none_is_believed(drive):
    system, _ = run(drive[1], 0.0)
    assert system.calibration.learnt.information > 0.0
    assert system.calibration.applied == 0.0


@pytest.mark.parametrize(("step_m", "told"), [(0.5, False), (3.0, True)])
def test_what_all_patches_may_err_by_is_not_believed(step_m, told):
    """0.001 1/m moves points by 0.085 px in a step of half a metre, by 0.51 px in one of three."""
    calibration = DepthCalibration(CAMERA, default_config("dpl"))
    calibration.learnt = DepthOffset().observed(0.001, 1e-5)
    calibration.count_pair(step_m)
    assert (calibration.due() > 0.0) == told
    calibration.apply(0.0005)                      # believed once: it is followed from then on
    assert calibration.due() == pytest.approx(0.0005)


def test_a_setting_leaves_it_out(drive):
    system, _ = run(drive[1], 0.004, learn_depth_offset=False)
    assert system.calibration.learnt.information == 0.0
    assert system.calibration.applied == 0.0


@given(st.floats(-0.01, 0.01), st.integers(0, 2**32 - 1))
def test_depth_is_shifted_in_its_inverse_and_none_stays_none(offset, seed):
    rng = np.random.default_rng(seed)
    depth = np.where(rng.uniform(size=50) < 0.2, 0.0, rng.uniform(0.5, 60.0, 50))
    moved = shifted_depth(depth, offset)
    known = depth > 0
    assert_array_equal(moved > 0, known)
    assert_allclose(1.0 / moved[known], 1.0 / depth[known] + offset, atol=1e-12)
    assert shifted_depth(depth.astype(np.float32), offset).dtype == np.float32


def test_what_would_lie_behind_the_horizon_is_far():
    assert shifted_depth(np.array([200.0]), -0.01)[0] > 1e5


@given(st.floats(-0.004, 0.01), st.integers(0, 2**32 - 1))
def test_landmarks_stay_on_the_rays_that_they_were_first_seen_on(offset, seed):
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(size=6))
    uv, z = rng.uniform([0, 0], [320, 240], (20, 2)), rng.uniform(2.0, 80.0, 20)
    map_ = PointLineMap()
    nothing = np.zeros(0, np.int64)
    keyframe = map_.add_keyframe(0, T, Features(no_points(), no_lines()), nothing, nothing)
    xyz = se3.transform_points(T, back_project(CAMERA, uv, z))
    map_.points.add(xyz[:, None], np.zeros((20, 32), np.uint8), np.zeros(20, np.int32), T[:3, 3],
                    keyframe.number)
    config = default_config("dpl")
    distance = map_.points.distance.copy()
    recalibrate(map_, LandmarkMemory(CAMERA, config), offset, CAMERA, config)
    seen = se3.transform_points(se3.inverse(T), map_.points.xyz[:, 0])
    assert_allclose(1.0 / seen[:, 2], 1.0 / z + offset, rtol=1e-6)
    assert_allclose(project(CAMERA, seen), uv, atol=1e-6)
    assert_allclose(map_.points.distance / distance, seen[:, 2] / z, rtol=1e-9)
