"""The system on small ray-cast scenes: motions, what stands, what starts and stops."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import box_world as bw
import slam
from slam.config import DynamicConfig, SdplConfig
from slam.geometry import se3
from slam.systems.sdpl import SdplSlam
from slam.types import Status


def run(frames, name="sdpl"):
    system = slam.make(name, frames[0].intrinsics)
    return system, [system.process(frame) for frame in frames]


def without_flow(frames):
    return [replace(frame, flow=None) for frame in frames]


def moving_labels(estimate):
    return {motion.instance_id for motion in estimate.objects.values()}


@pytest.mark.parametrize(("own_flow", "camera_mm", "object_mm", "object_deg"),
                         [(False, 0.4, 0.6, 0.02), (True, 1.0, 1.5, 0.3)])
def test_camera_and_object_motions_are_found(two_boxes, own_flow, camera_mm, object_mm,
                                             object_deg):
    camera, boxes, frames = two_boxes
    _, estimates = run(without_flow(frames) if own_flow else frames)
    assert [e.status for e in estimates] == [Status.FIRST] + [Status.TRACKED] * (len(frames) - 1)
    t, r = bw.camera_errors(camera, estimates)
    assert t.mean() * 1e3 < camera_mm          # it moves by 35 mm a frame
    assert np.degrees(r.mean()) < 0.01
    assert [moving_labels(e) for e in estimates[1:]] == [{3}] * (len(frames) - 1)
    errors = np.array([bw.object_errors(camera, boxes[3].T_world_box, e.index, motion.H_world)
                       for e in estimates for motion in e.objects.values()])
    assert errors[:, 0].mean() * 1e3 < object_mm          # it moves by 54 mm a frame
    assert np.degrees(errors[:, 1].mean()) < object_deg   # and turns by 1.8°


def test_a_motion_whose_rotation_is_hardly_known_is_left_out_with_the_reason(two_boxes):
    camera, _, frames = two_boxes
    demanding = SdplConfig(dynamic=DynamicConfig(max_rotation_sigma=1e-7))
    system = SdplSlam(frames[0].intrinsics, demanding)
    estimates = [system.process(frame) for frame in frames[:4]]
    assert all(not e.objects and "its rotation is known to" in e.reason for e in estimates[1:])
    t, _ = bw.camera_errors(camera, estimates)
    assert t.mean() * 1e3 < 0.4


def test_a_mask_that_continues_none_is_named_with_the_reason(two_boxes):
    _, _, frames = two_boxes
    labels = np.array(frames[2].instance_id)
    labels[60, 80:83] = 77
    spoilt = [*frames[:2], replace(frames[2], instance_id=labels), frames[3]]
    _, estimates = run(spoilt)
    assert "mask 77: first seen" in estimates[2].reason
    assert not estimates[1].reason


def test_the_box_that_stands_is_named_static_and_its_centre_is_not_tracked(two_boxes):
    _, _, frames = two_boxes
    _, estimates = run(frames)
    assert all(e.static_labels == (5,) for e in estimates[1:])


def test_the_centroid_is_that_of_the_previous_frame(two_boxes):
    camera, boxes, frames = two_boxes
    _, estimates = run(frames)
    for e in estimates[1:]:
        (motion,) = e.objects.values()
        centre = boxes[3].T_world_box[e.index - 1, :3, 3]
        found = se3.transform_points(camera[0], motion.centroid_world[None])[0]
        assert np.linalg.norm(found - centre) < 0.6        # on its surface, half a box away


def test_a_track_keeps_its_number_through_new_labels_in_every_frame(two_boxes):
    _, _, frames = two_boxes
    names = [{3: 11 + 2 * (k % 3), 5: 400 - k} for k in range(len(frames))]
    shuffled = [replace(f, instance_id=bw._renamed(np.asarray(f.instance_id), n))
                for f, n in zip(frames, names, strict=True)]
    _, estimates = run(shuffled)
    _, plain = run(frames)
    assert len({track for e in estimates for track in e.objects}) == 1
    for e, same, name in zip(estimates[1:], plain[1:], names[1:], strict=True):
        assert moving_labels(e) == {name[3]}
        assert_allclose(e.T_world_camera, same.T_world_camera, atol=1e-9)


def test_the_result_tells_the_run_as_it_was(two_boxes):
    _, _, frames = two_boxes
    system, estimates = run(frames)
    result = system.finish()
    assert_array_equal(result.stamps_s, [f.stamp_s for f in frames])
    assert_array_equal(result.T_world_camera, [e.T_world_camera for e in estimates])
    assert result.status == tuple(e.status for e in estimates)
    ((track, motions),) = result.objects.items()
    assert_array_equal(motions.frames, range(1, len(frames)))
    assert_array_equal(motions.H_world, [e.objects[track].H_world for e in estimates[1:]])
    assert result.static_line_tracklet_lengths.max() >= 5


def test_of_old_estimates_the_features_are_not_kept(two_boxes):
    _, _, frames = two_boxes
    system, estimates = run(frames[:4])
    assert all(len(e.points) and len(e.segments) for e in estimates)
    assert all(e.points is None and e.segments is None for e in system.history.estimates)
    assert_array_equal([e.T_world_camera for e in system.history.estimates],
                       [e.T_world_camera for e in estimates])


def test_features_live_on_over_many_frames_on_their_own_things(two_boxes):
    _, _, frames = two_boxes
    _, estimates = run(frames)
    first, last = (set(estimates[k].points.track_id) for k in (2, len(frames) - 1))
    assert len(first & last) > 0.3 * len(first)
    for e, frame in zip(estimates, frames, strict=True):
        column, row = np.rint(e.points.uv_px).astype(int).T
        assert_array_equal(np.asarray(frame.instance_id)[row, column], e.points.instance_id)
        assert len(set(e.points.track_id)) == len(e.points)
        assert len(set(e.segments.track_id)) == len(e.segments)


def test_presets_differ_as_they_are_named(two_boxes):
    _, _, frames = two_boxes
    frames = without_flow(frames)
    ours, vdo, as_measured = (run(frames, name)[1] for name in ("sdpl", "vdo",
                                                                "sdpl-no-flow-opt"))
    assert all(len(e.segments) == 0 and e.inliers.get("lines", 0) == 0 for e in vdo)
    assert max(e.inliers.get("lines", 0) for e in ours) > 5
    assert not np.array_equal(ours[-1].T_world_camera, vdo[-1].T_world_camera)
    assert not np.array_equal(ours[-1].T_world_camera, as_measured[-1].T_world_camera)


def scene_of_one(path, frames, camera_amount=1.0, half=(0.5, 0.45, 0.4)):
    camera = bw.hand_held(frames, camera_amount)
    boxes = {4: bw.Box(half, path)}
    return camera, boxes, bw.sequence(camera, boxes)


def test_a_parked_box_that_starts_to_move_is_noticed_and_does_not_drag_the_camera():
    camera, boxes, frames = scene_of_one(
        bw.moving(0.2, 0.1, -0.4, 9, (0.06, 0.0, 0.0), start=4), 9)
    _, estimates = run(frames)
    assert [moving_labels(e) for e in estimates[1:5]] == [set()] * 4
    assert [moving_labels(e) for e in estimates[6:]] == [{4}] * 3
    t, _ = bw.camera_errors(camera, estimates)
    assert t.max() < 2e-3
    motions = [(e.index, m.H_world) for e in estimates[6:] for m in e.objects.values()]
    for k, H in motions:
        assert bw.object_errors(camera, boxes[4].T_world_box, k, H)[0] < 2e-3


def test_a_box_that_stops_stays_a_moving_one_for_a_second_only():
    path = bw.moving(0.0, 0.1, 0.0, 19, (0.06, 0.0, 0.0))
    path[5:] = path[4]
    _, _, frames = scene_of_one(path, 19)
    _, estimates = run(frames)
    assert all(moving_labels(e) == {4} for e in estimates[1:14])
    assert [moving_labels(e) for e in estimates[16:]] == [set()] * 3
    assert all(e.static_labels == (4,) for e in estimates[16:])


def test_what_is_parked_carries_the_camera_where_nothing_else_is_seen():
    """Once judged to stand, a thing is part of the static world: it alone is enough."""
    camera, _, frames = scene_of_one(bw.standing(0.0, 0.0, -0.8, 8), 8, half=(0.9, 0.7, 0.5))
    bare = []
    for k, frame in enumerate(frames):
        depth = np.array(frame.depth_m)
        if k >= 4:
            depth[np.asarray(frame.instance_id) == 0] = 0.0
        bare.append(replace(frame, depth_m=depth))
    _, estimates = run(bare)
    assert all(e.status == Status.TRACKED for e in estimates[1:])
    t, _ = bw.camera_errors(camera, estimates)
    assert t.max() < 2e-3


def test_one_huge_moving_thing_is_not_taken_for_the_world():
    """Four fifths of the image move: the background is a fifth, and still the background."""
    camera, _, frames = scene_of_one(
        bw.moving(-0.1, 0.0, -0.9, 6, (0.04, 0.0, 0.0)), 6, half=(0.9, 0.7, 0.3))
    share = np.mean(np.asarray(frames[0].instance_id) == 4)
    assert share > 0.7
    _, estimates = run(frames)
    assert all(e.status == Status.TRACKED for e in estimates[1:])
    t, _ = bw.camera_errors(camera, estimates)
    assert t.max() < 3e-3
    assert [moving_labels(e) for e in estimates[1:]] == [{4}] * 5


def test_a_camera_that_stands_still_is_found_to():
    _, _, frames = scene_of_one(bw.standing(0.0, 0.1, 0.0, 5), 5, camera_amount=0.0)
    for given in (frames, without_flow(frames)):
        _, estimates = run(given)
        assert all(e.status == Status.TRACKED for e in estimates[1:])
        for e in estimates[1:]:
            assert_allclose(e.T_previous_camera, np.eye(4), atol=2e-5)
        assert not any(e.objects for e in estimates)


def test_a_still_camera_sees_what_moves():
    camera, boxes, frames = scene_of_one(bw.moving(-0.3, 0.1, 0.0, 5, (0.05, 0.01, 0.0)), 5,
                                         camera_amount=0.0)
    _, estimates = run(frames)
    for e in estimates[1:]:
        assert_allclose(e.T_previous_camera, np.eye(4), atol=1e-4)
        (motion,) = e.objects.values()
        assert bw.object_errors(camera, boxes[4].T_world_box, e.index, motion.H_world)[0] < 2e-3


def test_without_masks_the_moving_box_is_outvoted(two_boxes):
    camera, _, frames = two_boxes
    _, estimates = run([replace(f, instance_id=None) for f in frames])
    assert all(e.status == Status.TRACKED for e in estimates[1:])
    assert bw.camera_errors(camera, estimates)[0].mean() < 2e-3
    assert not any(e.objects for e in estimates)
