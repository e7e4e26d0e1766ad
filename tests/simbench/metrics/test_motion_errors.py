"""E_t and E_R: zero for the truth, known for a known error, the same in any world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.metrics.association import owners
from simbench.metrics.camera import camera_metrics
from simbench.metrics.estimates import CameraEstimates, ObjectMotions, camera_from_poses
from simbench.metrics.motion import motion_errors
from simbench.metrics.objects import object_errors, object_metrics
from slam.geometry import se3
from strategies import rigid_transforms
from synthetic import exact_camera, exact_motions, world

TRUTH = world()


def objects_block(motions: ObjectMotions, camera: CameraEstimates) -> dict:
    owner = owners(motions.track, motions.stands_on)
    return object_metrics(object_errors(motions, owner, camera, TRUTH, True), motions, owner,
                          TRUTH, True)


@given(st.floats(-9.0, 0.0), st.floats(-9.0, 0.0), rigid_transforms())
def test_the_angle_is_right_down_to_a_billionth_of_a_degree(deg_exponent, m_exponent, T):
    angle, shift = 10.0 ** deg_exponent, 10.0 ** m_exponent
    P = se3.from_rotation_translation(se3.exp_so3(np.radians([0.0, angle, 0.0])),
                                      np.array([0.0, 0.0, shift]))
    t, r = motion_errors(T, T @ P)
    assert r == pytest.approx(angle, rel=1e-5, abs=1e-13)
    assert t == pytest.approx(shift, rel=1e-5, abs=1e-13)


@given(rigid_transforms())
def test_the_truth_in_any_world_has_no_error(A):
    camera = exact_camera(TRUTH, A)
    out = camera_metrics(camera, TRUTH, True)
    assert out["E_t"] < 1e-12
    assert out["E_R"] < 1e-10
    assert out["coverage"] == 1.0
    assert out["ate"]["rmse"] < 1e-12
    for key in ("1f", "10f", "1s"):
        assert out["rpe"][key]["t_rmse"] < 1e-11
        assert out["rpe"][key]["r_rmse_deg"] < 1e-10
    objects = objects_block(exact_motions(TRUTH, camera, {1: 7, 2: 3}), camera)
    for key in ("1", "2", "mean"):
        assert objects[key]["E_t"] < 1e-11
        assert objects[key]["E_R_local"] < 1e-10
        assert objects[key]["coverage"] == 1.0


@given(rigid_transforms(), st.integers(0, 2 ** 31))
def test_moving_the_whole_estimate_changes_no_error(A, seed):
    rng = np.random.default_rng(seed)
    noise = se3.exp(0.01 * rng.normal(size=(len(TRUTH.stamps_s), 6)))
    here = camera_from_poses(exact_camera(TRUTH).T_world_camera @ noise, TRUTH.camera_valid)
    there = camera_from_poses(A @ here.T_world_camera, TRUTH.camera_valid)
    P = se3.exp(0.02 * rng.normal(size=6))
    motions = exact_motions(TRUTH, here, {1: 7, 2: 3}, P)
    moved = ObjectMotions(motions.frame, motions.track, A @ motions.H_world @ se3.inverse(A),
                          se3.transform_points(A, motions.centroid_world),
                          A @ motions.T_world_camera, motions.stands_on)
    one, other = camera_metrics(here, TRUTH, True), camera_metrics(there, TRUTH, True)
    for key in ("E_t", "E_R"):
        assert one[key] == pytest.approx(other[key], rel=1e-8)
    assert one["ate"]["rmse"] == pytest.approx(other["ate"]["rmse"], rel=1e-8)
    assert one["rpe"]["1s"]["t_rmse"] == pytest.approx(other["rpe"]["1s"]["t_rmse"], rel=1e-8)
    for block, same in ((objects_block(motions, here)[k], objects_block(moved, there)[k])
                        for k in ("1", "2", "mean")):
        for key in ("E_t", "E_R", "E_t_local", "E_R_local"):
            assert block[key] == pytest.approx(same[key], rel=1e-7)


@given(rigid_transforms(reach_m=0.2))
def test_a_known_object_error_is_found(P):
    camera = exact_camera(TRUTH)
    out = objects_block(exact_motions(TRUTH, camera, {1: 7, 2: 3}, P), camera)
    expected = motion_errors(np.eye(4), P)
    assert out["1"]["E_t"] == pytest.approx(expected[0], abs=1e-9)
    assert out["2"]["E_R"] == pytest.approx(expected[1], abs=1e-5)
    assert out["1"]["E_t_local"] == pytest.approx(expected[0], abs=1e-9)


def test_drift_of_the_camera_is_in_the_world_error_and_not_in_the_local_one():
    drift = se3.exp(np.outer(np.arange(len(TRUTH.stamps_s)), [0.0, 0.002, 0.0, 0.01, 0.0, 0.0]))
    true = exact_camera(TRUTH)
    camera = camera_from_poses(true.T_world_camera @ drift, TRUTH.camera_valid)
    exact = exact_motions(TRUTH, true, {1: 7, 2: 3})
    # The system sees the object's motion from its camera rightly, and places both wrongly.
    shift = camera.T_world_camera @ se3.inverse(true.T_world_camera)
    D = shift[exact.frame - 1]
    motions = ObjectMotions(exact.frame, exact.track, D @ exact.H_world @ se3.inverse(D),
                            exact.centroid_world, camera.T_world_camera[exact.frame - 1],
                            exact.stands_on)
    out = objects_block(motions, camera)["mean"]
    assert out["E_t_local"] < 1e-10
    assert out["E_t"] > 1e-3


def test_a_parked_object_without_a_track_is_no_miss_and_with_one_a_false_motion():
    camera = exact_camera(TRUTH)
    out = objects_block(exact_motions(TRUTH, camera, {1: 7}), camera)
    assert out["3"] == {"rigid": True, "moving_frames": 0, "frames": 0, "false_motions": 0,
                        "name": "thing 3"}
    assert out["2"]["coverage"] == 0.0
    assert "E_t" not in out["2"]
    assert out["mean"]["coverage"] == 0.5
    parked = objects_block(exact_motions(TRUTH, camera, {1: 7, 3: 9}), camera)
    assert parked["3"]["false_motions"] == len(TRUTH.stamps_s) - 1
    assert "E_t" not in parked["3"]
