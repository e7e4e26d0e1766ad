"""The global batch on ray-cast scenes: better than tracking, and whole whatever a frame holds."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import box_world as bw
import slam
from slam.geometry import se3
from slam.systems.registry import default_config
from slam.types import Status

FRAMES = 20
BAD = 10


@pytest.fixture(scope="module")
def scene():
    """A hand-held camera, a box that moves and turns; no flow."""
    camera = bw.hand_held(FRAMES)
    box = bw.Box((0.35, 0.3, 0.3), bw.moving(-0.5, 0.1, 0.0, FRAMES, (0.03, 0.0, 0.02),
                                             (0.0, 0.03, 0.0)))
    return camera, box, bw.sequence(camera, {3: box}, with_flow=False)


def run(frames):
    system = slam.make("sdpl-batch", frames[0].intrinsics)
    estimates = [system.process(frame) for frame in frames]
    return system.tracker.finish(), system.finish(), estimates


def camera_error(T, truth):
    relative = se3.inverse(truth[0]) @ truth
    return np.sqrt(np.mean(np.sum((T[:, :3, 3] - relative[:, :3, 3]) ** 2, axis=1)))


def object_drift(result, camera, box, span=8):
    """Mean error (m) of the object's motion over `span` frames, seen from the true camera."""
    errors = []
    for track in result.objects.values():
        H = dict(zip(track.frames.tolist(), track.H_world, strict=True))
        for k in sorted(H):
            if all(k + i in H for i in range(span)):
                total = np.eye(4)
                for i in range(span):
                    total = H[k + i] @ total
                A = camera[k - 1] @ se3.inverse(result.T_world_camera[k - 1])
                total = A @ total @ se3.inverse(A)
                L0, L1 = box.T_world_box[k - 1], box.T_world_box[k - 1 + span]
                errors.append(np.linalg.norm((se3.inverse(L1) @ total @ L0)[:3, 3]))
    return np.mean(errors)


def test_the_batch_is_better_than_tracking(scene):
    camera, box, frames = scene
    tracked, refined, _ = run(frames)
    assert camera_error(refined.T_world_camera, camera) < 0.8 * camera_error(
        tracked.T_world_camera, camera)
    assert object_drift(refined, camera, box) < 0.9 * object_drift(tracked, camera, box)
    assert refined.status == tracked.status
    assert len(refined.points_world) > 50


def motion_errors(estimates, box, camera):
    """Mean errors (m) of the motions that `process` returned, of the box and of the camera."""
    of_box, of_camera = [], []
    for before, e in pairwise(estimates):
        step = se3.inverse(camera[e.index - 1]) @ camera[e.index]
        of_camera.append(np.linalg.norm((se3.inverse(e.T_previous_camera) @ step)[:3, 3]))
        for motion in e.objects.values():
            A = camera[e.index - 1] @ se3.inverse(before.T_world_camera)
            L0, L1 = box.T_world_box[e.index - 1], box.T_world_box[e.index]
            moved = se3.inverse(L0) @ A @ motion.H_world @ se3.inverse(A) @ L0
            of_box.append(np.linalg.norm((se3.inverse(moved) @ se3.inverse(L0) @ L1)[:3, 3]))
    return np.mean(of_box), np.mean(of_camera)


def test_motions_that_process_returns_are_the_windows(scene):
    camera, box, frames = scene
    alone, system = (slam.make(name, frames[0].intrinsics) for name in ("sdpl", "sdpl-partial"))
    tracked = motion_errors([alone.process(f) for f in frames], box, camera)
    estimates = [system.process(f) for f in frames]
    windowed = motion_errors(estimates, box, camera)
    assert windowed[0] < 1.02 * tracked[0]
    assert windowed[1] < 0.95 * tracked[1]
    # The tracker predicts from them.
    last = estimates[-1]
    for track, motion in last.objects.items():
        assert_array_equal(system.tracker.objects.states[track].H_world, motion.H_world)
    # What the window has taken in is not kept where no global batch will want it.
    assert len(system.record.points.observations()) == 0
    assert len(system.record.lines.landmarks()) == 0


@pytest.mark.parametrize(("name", "on_objects", "static_lines", "object_lines"), [
    ("sdpl-batch", True, True, True), ("sdpl-batch-no-lines", True, False, False),
    ("sdpl-batch-static-lines", True, True, False), ("sdpl-batch-static", False, True, False)])
def test_ablations_leave_out_what_they_say(name, on_objects, static_lines, object_lines):
    box = bw.Box((0.8, 0.6, 0.5), bw.moving(-0.2, 0.1, -0.8, 6, (0.03, 0.0, 0.02), (0, 0.03, 0)))
    system = slam.make(name, bw.CAMERA)                  # a box so large that its edges are lines
    for frame in bw.sequence(bw.hand_held(6), {3: box}, with_flow=False):
        system.process(frame)
    points, lines = system.record.points.landmarks(), system.record.lines.landmarks()
    assert (points.body == 0).any()
    assert (points.body > 0).any() == on_objects
    assert (lines.body == 0).any() == static_lines
    assert (lines.body > 0).any() == object_lines


@pytest.mark.parametrize("name", ["sdpl-batch", "sdpl-partial"])
def test_a_setting_picks_the_form_of_lines_in_both_batches(scene, name):
    _, _, frames = scene
    poses = {}
    for form in ("well_conditioned", "paper"):
        config = default_config(name)
        bundle = replace(config.backend.bundle, line_form=form)
        config = replace(config, backend=replace(config.backend, bundle=bundle))
        system = slam.make(name, frames[0].intrinsics, config)
        for frame in frames[:8]:
            system.process(frame)
        poses[form] = system.finish().T_world_camera
        assert camera_error(poses[form], scene[0][:8]) < 0.01
    assert np.abs(poses["paper"] - poses["well_conditioned"]).max() > 1e-7


@pytest.mark.parametrize("name", ["sdpl-batch", "sdpl-paper-batch"])
def test_covariances_are_stated_on_request(scene, name):
    camera, box, frames = scene
    spoilt = [black(without_depth(f)) if f.index == 5 else f for f in frames[:10]]
    for asked in (False, True):
        config = default_config(name)
        bundle = replace(config.backend.bundle, covariances=asked)
        system = slam.make(name, frames[0].intrinsics,
                           replace(config, backend=replace(config.backend, bundle=bundle)))
        estimates = [system.process(frame) for frame in spoilt]
        result = system.finish()
        (track,) = result.objects.values()
        if not asked:
            assert all(e.covariance is None for e in estimates)
            assert result.step_covariance is None
            assert track.covariance is None
            continue
        for before, e in pairwise(estimates):
            assert_allclose(before.T_world_camera @ e.T_previous_camera, e.T_world_camera,
                            atol=2e-3)
        online = [e.index for e in estimates if e.covariance is not None]
        assert online == [1, 2, 3, 4, 7, 8, 9]                         # 6 is over a lost frame
        stated = np.isfinite(result.step_covariance).all(axis=(1, 2))
        assert np.flatnonzero(stated).tolist() == online
        assert np.isfinite(track.covariance).all(axis=(1, 2)).sum() >= 5
        for k in np.flatnonzero(stated):
            step = se3.inverse(result.T_world_camera[k - 1]) @ result.T_world_camera[k]
            error = se3.log(se3.inverse(step) @ se3.inverse(camera[k - 1]) @ camera[k])
            assert error @ np.linalg.solve(result.step_covariance[k], error) < 300.0
        for k, H, P in zip(track.frames, track.H_world, track.covariance, strict=True):
            if np.isfinite(P).all():
                S = camera[k - 1] @ se3.inverse(result.T_world_camera[k - 1])
                true = box.T_world_box[k] @ se3.inverse(box.T_world_box[k - 1])
                error = se3.log(se3.inverse(S @ H @ se3.inverse(S)) @ true)
                assert error @ np.linalg.solve(P, error) < 3000.0


def black(frame):
    return replace(frame, rgb=np.zeros_like(frame.rgb))


def without_depth(frame):
    return replace(frame, depth_m=np.zeros_like(frame.depth_m))


def without_masks(frame):
    return replace(frame, instance_id=np.zeros_like(frame.instance_id))


@pytest.mark.parametrize("spoil", [black, without_depth, without_masks])
@pytest.mark.parametrize("length", [1, 4])
def test_frames_lost_in_the_middle_leave_the_rest_whole(scene, spoil, length):
    camera, _, frames = scene
    spoilt = [spoil(f) if BAD <= f.index < BAD + length else f for f in frames]
    tracked, refined, estimates = run(spoilt)
    assert np.isfinite(refined.T_world_camera).all()
    assert all(np.isfinite(t.H_world).all() for t in refined.objects.values())
    assert [len(t.frames) for t in refined.objects.values()] == [
        len(t.frames) for t in tracked.objects.values()]
    before = slice(0, BAD)
    assert camera_error(refined.T_world_camera[before], camera[before]) < 0.01
    if spoil is without_masks:
        assert all(e.status is not Status.LOST for e in estimates)
        assert camera_error(refined.T_world_camera, camera) < 0.02


def test_indices_need_not_begin_at_zero_nor_be_dense(scene):
    _, _, frames = scene
    first = run(frames[:8])[1]
    shifted = [replace(f, index=100 + 3 * f.index) for f in frames[:8]]
    second = run(shifted)[1]
    assert_array_equal(first.T_world_camera, second.T_world_camera)
    for a, b in zip(first.objects.values(), second.objects.values(), strict=True):
        assert_array_equal(100 + 3 * a.frames, b.frames)
        assert_array_equal(a.H_world, b.H_world)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_runs(scene, count):
    _, _, frames = scene
    if count == 0:
        assert len(slam.make("sdpl-batch", bw.CAMERA).finish().stamps_s) == 0
    else:
        refined = run(frames[:count])[1]
        assert refined.T_world_camera.shape == (count, 4, 4)
        assert np.isfinite(refined.T_world_camera).all()


def test_runs_are_bit_equal(scene):
    _, _, frames = scene
    one, other = run(frames[:8])[1], run(frames[:8])[1]
    assert one.T_world_camera.tobytes() == other.T_world_camera.tobytes()
    assert one.points_world.tobytes() == other.points_world.tobytes()


def test_a_global_batch_may_be_asked_for_at_any_time(scene):
    _, _, frames = scene
    system = slam.make("sdpl-batch", frames[0].intrinsics)
    for frame in frames[:6]:
        system.process(frame)
    early = system.finish()
    for frame in frames[6:8]:
        system.process(frame)
    assert early.T_world_camera.shape == (6, 4, 4)
    assert_array_equal(system.finish().T_world_camera, run(frames[:8])[1].T_world_camera)


@pytest.mark.parametrize("name", ["sdpl-batch", "sdpl-paper-batch"])
def test_the_map_holds_segments_that_lie_on_what_stands(name):
    count = 6
    camera = bw.hand_held(count)
    path = bw.standing(-0.2, 0.1, -0.8, count)
    box = bw.Box((0.8, 0.6, 0.5), path)
    frames = bw.sequence(camera, {3: box}, with_flow=False)
    system = slam.make(name, bw.CAMERA)
    for frame in frames:
        system.process(without_masks(frame))
    segments = system.finish().lines_world
    assert len(segments) >= 5
    world = se3.transform_points(camera[0], segments.reshape(-1, 3))
    in_box = np.abs(se3.transform_points(se3.inverse(path[0]), world)) / box.half_m
    in_room = np.abs(world / bw.ROOM)
    beside = np.minimum(*(np.abs(part.max(axis=1) - 1.0) for part in (in_box, in_room)))
    assert np.quantile(beside, 0.8) < 0.03               # on a face of the box or on a wall
    assert np.median(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)) > 0.2


@pytest.mark.parametrize("own_flow", [True, False])
def test_what_bends_is_reported_and_weighs_less(own_flow):
    """Two boxes under one mask that move apart, beside one that is rigid."""
    count = 8
    camera = bw.hand_held(count)
    part = bw.moving(-0.05, 0.45, -0.1, count, (0.08, -0.03, 0.02))
    boxes = {3: bw.Box((0.4, 0.35, 0.3), bw.moving(-0.5, 0.1, 0.0, count, (0.05, 0.0, 0.02))),
             4: bw.Box((0.2, 0.3, 0.25), part),
             5: bw.Box((0.3, 0.4, 0.3), bw.moving(1.0, 0.4, 0.5, count, (-0.05, 0.0, 0.0)))}
    frames = bw.sequence(camera, boxes, with_flow=not own_flow, labels={3: 3, 4: 3, 5: 5})
    system = slam.make("sdpl-batch", frames[0].intrinsics)
    estimates = [system.process(frame) for frame in frames]
    bends, rigid = (np.mean([m.rigidity for e in estimates for m in e.objects.values()
                             if m.instance_id == label]) for label in (3, 5))
    assert bends < rigid - 0.15
    assert bw.camera_errors(camera, estimates)[0].max() < 2e-3
    claimed = {o.label: o.information for o in system._motions.last.objects}
    for track, motion in estimates[-1].objects.items():
        body = system.record.bodies[system._body_of_track[track]]
        assert body.rigidity[-1] == motion.rigidity < 1.0
        assert_allclose(body.information[-1], motion.rigidity**2 * claimed[motion.instance_id])


def no_box_after(frame, last=9):
    return without_masks(frame) if frame.index > last else frame


def two_points(frame):
    """The box's mask shrinks to two pixels."""
    labels = np.zeros_like(frame.instance_id)
    v, u = np.nonzero(frame.instance_id)
    if len(v) and frame.index > 3:
        labels[v[:2], u[:2]] = frame.instance_id[v[0], u[0]]
        return replace(frame, instance_id=labels)
    return frame


def lost_at_six(frame):
    return black(without_depth(frame)) if frame.index == 6 else frame


@pytest.mark.parametrize("spoil", [no_box_after, two_points, lost_at_six])
@pytest.mark.parametrize("name", ["sdpl-batch", "sdpl-paper-batch"])
def test_what_is_missing_is_said_and_leaves_the_rest_whole(scene, spoil, name):
    """A track that ends inside the window, an object of two points, a frame lost in the middle."""
    _, _, frames = scene
    system = slam.make(name, frames[0].intrinsics)
    estimates = [system.process(spoil(frame)) for frame in frames[:12]]
    refined = system.finish()
    for e in estimates:
        assert np.isfinite(e.T_world_camera).all()
        assert all(np.isfinite(m.H_world).all() for m in e.objects.values())
    assert np.isfinite(refined.T_world_camera).all()
    assert np.isfinite(refined.points_world).all()
    assert all(np.isfinite(t.H_world).all() for t in refined.objects.values())
    if spoil is two_points:
        # Masks that are missed are carried on for a while; then there is nothing of it.
        assert not any(e.objects for e in estimates[9:])
    if spoil is lost_at_six:
        assert estimates[6].status is Status.LOST
        assert estimates[6].reason
