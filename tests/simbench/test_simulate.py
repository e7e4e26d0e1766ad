"""A simulated sequence in memory."""

import cv2
import numpy as np
import pytest

from simbench.errors import UserError
from simbench.render import make_renderer
from simbench.sequence import Sequence
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.geometry import se3


def _sequence(spec, frames=8, **options):
    world = make_world(spec, **options)
    return SimulatedSequence(world, make_renderer("mujoco", world), frames)


def test_frames_are_equal_in_any_order(marker_spec):
    forward, backward = _sequence(marker_spec), _sequence(marker_spec)
    kept = [forward.frame(k) for k in range(8)]
    for k in reversed(range(8)):
        again = backward.frame(k)
        assert np.array_equal(again.rgb, kept[k].rgb)
        assert np.array_equal(again.depth_m, kept[k].depth_m)
        assert np.array_equal(again.instance_id, kept[k].instance_id)
        if k:
            assert np.array_equal(again.flow.flow_px, kept[k].flow.flow_px)
            assert np.array_equal(again.flow.valid, kept[k].flow.valid)


def test_a_frame_is_its_truth_and_the_flow_from_the_one_before(marker_sequence):
    assert isinstance(marker_sequence, Sequence)
    frame, truth = marker_sequence.frame(5), marker_sequence.truth.frame(5)
    assert np.array_equal(frame.depth_m, truth.depth_m)
    assert np.array_equal(frame.instance_id, marker_sequence.truth.true_instances(5))
    flow = marker_sequence.truth.flow(4, 5)
    assert np.array_equal(frame.flow.flow_px, flow.flow_px)
    assert np.array_equal(frame.flow.valid, flow.valid & ~flow.leaving)
    assert marker_sequence.frame(0).flow is None


def test_trajectories_are_the_poses_of_the_frames(marker_spec):
    sequence = _sequence(marker_spec)
    truth = sequence.truth
    trajectories = truth.trajectories
    assert np.array_equal(trajectories.stamps_s, sequence.stamps_s)
    for k in (0, 3, 7):
        frame = truth.frame(k)
        assert np.array_equal(trajectories.T_world_camera[k], frame.T_world_camera)
        for each in truth.layout.objects:
            poses = trajectories.objects[each.instance_id]
            assert np.array_equal(poses.T_world_object[k], frame.T_world_part[each.root_part])
            assert poses.valid[k] == (frame.instance_id == each.instance_id).any()
    box = next(each for each in truth.layout.objects if each.name == "box")
    assert not trajectories.objects[box.instance_id].rigid   # its flap moves against it


def test_a_blurred_picture_is_centred_on_its_stamp(marker_spec):
    sequence = _sequence(marker_spec)
    sharp = sequence.rgb(3)
    assert np.array_equal(sequence.render_blurred(3, 0.0, 3), sharp)
    blurred = sequence.render_blurred(3, 0.1, 5)
    assert np.abs(blurred.astype(int) - sharp).max() > 20
    # What moves evenly is as long before its place as after it.
    shift = [(np.abs(sequence.rgb(k).astype(float) - blurred)).mean() for k in (2, 3, 4)]
    assert shift[1] < 0.8 * min(shift[0], shift[2])
    assert abs(shift[0] - shift[2]) < 0.3 * shift[0]
    assert np.array_equal(sequence.rgb(3), sharp)
    with pytest.raises(UserError, match="exposure"):
        sequence.render_blurred(3, 0.2, 5)


def test_the_first_picture_has_no_time_before_it(marker_spec):
    sequence = _sequence(marker_spec)
    assert np.array_equal(sequence.render_blurred(0, 0.1, 4), sequence.rgb(0))


def test_fingerprints_tell_sequences_apart(marker_spec):
    plain = _sequence(marker_spec).fingerprint()
    assert plain == _sequence(marker_spec).fingerprint()
    others = {_sequence(marker_spec, frames=7).fingerprint(),
              _sequence(marker_spec, seed=1).fingerprint(),
              _sequence(marker_spec, size=(160, 120)).fingerprint(),
              _sequence(marker_spec, dials={"light": 0.5}).fingerprint()}
    assert len(others | {plain}) == 5


def test_a_sequence_has_at_least_one_frame(marker_spec):
    with pytest.raises(UserError, match="frames 0"):
        _sequence(marker_spec, frames=0)


def test_the_motion_of_an_object_carries_its_scene_flow(marker_sequence):
    truth = marker_sequence.truth
    a, b, flow = truth.frame(2), truth.frame(6), truth.flow(2, 6)
    ball = next(each for each in truth.layout.objects if each.name == "ball")
    v, u = np.nonzero(a.instance_id == ball.instance_id)
    intrinsics = marker_sequence.intrinsics
    z = a.depth_m[v, u].astype(float)
    points = np.stack([(u - intrinsics.cx) / intrinsics.fx * z,
                       (v - intrinsics.cy) / intrinsics.fy * z, z], axis=-1)
    world = se3.transform_points(a.T_world_camera, points)
    H = b.T_world_part[ball.root_part] @ se3.inverse(a.T_world_part[ball.root_part])
    assert np.allclose(flow.scene_flow_m[v, u], se3.transform_points(H, world) - world, atol=1e-5)
    background = a.instance_id == 0
    assert not flow.scene_flow_m[background].any()


def test_a_point_stands_its_disparity_further_left_in_the_right_image(marker_spec):
    world = make_world(marker_spec)
    renderer = make_renderer("mujoco", world)
    stereo = SimulatedSequence(world, renderer, frames=3, stereo=True)
    plain = SimulatedSequence(make_world(marker_spec), renderer, frames=3)
    frame = stereo.frame(1)
    np.testing.assert_array_equal(frame.rgb, plain.frame(1).rgb)   # the right one disturbs nothing
    assert stereo.fingerprint() != plain.fingerprint()
    i = frame.intrinsics
    v, u = np.mgrid[:i.height, :i.width].astype(np.float32)
    disparity = i.fx * i.baseline_m / np.maximum(frame.depth_m, 1e-3)
    moved = cv2.remap(frame.right, u - disparity, v, cv2.INTER_LINEAR)
    inside = (u - disparity > 0) & (frame.depth_m > 0)
    difference = np.abs(moved.astype(int) - frame.rgb).mean(axis=-1)
    # Half of the pixels at least are no border and hidden in neither image.
    assert np.median(difference[inside]) <= 3.0
    assert np.median(np.abs(frame.right.astype(int) - frame.rgb).mean(axis=-1)[inside]) \
        > 2.0 * np.median(difference[inside])
    renderer.close()
