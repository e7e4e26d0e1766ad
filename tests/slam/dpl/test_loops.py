"""A camera that turns once about itself in a ray-cast room: the loop is found and mends the run."""

from dataclasses import replace

import numpy as np
import pytest

import box_world as bw
import slam
from slam.dpl.features import Features, KeyPoints, no_lines, no_points
from slam.dpl.keyframes import PointLineMap
from slam.dpl.loop_close import LoopCloser, bent, between_living
from slam.dpl.loop_verify import Loop, covered
from slam.dpl.track import PoseTracker
from slam.geometry import se3
from slam.systems.registry import default_config
from slam.types import Status

ROUND, OVER = 44, 7
H, W = bw.CAMERA.height, bw.CAMERA.width


def camera_path():
    """(K, 4, 4): round in ROUND frames and on over what was seen first."""
    yaw = 2 * np.pi * np.arange(ROUND + OVER) / ROUND
    turn = se3.exp_so3(np.stack([0 * yaw, yaw, 0 * yaw], 1))
    return se3.from_rotation_translation(
        turn, np.stack([0.9 * np.sin(yaw), 0.1 * np.sin(3 * yaw), -0.9 * np.cos(yaw)], 1))


@pytest.fixture(scope="module")
def round_trip():
    """Noisy frames of the whole turn."""
    camera, rng = camera_path(), np.random.default_rng(0)
    frames = []
    for k, T in enumerate(camera):
        now = bw.render(T, {})
        depth = now.depth_m + 0.004 * now.depth_m**2 * rng.normal(size=now.depth_m.shape)
        frames.append(bw.Frame(k, k / bw.FPS, np.rint(now.rgb).astype(np.uint8),
                               depth.astype(np.float32), bw.CAMERA))
    return camera, frames


def run(frames, **loop):
    config = default_config("orb")
    system = slam.make("orb", bw.CAMERA, replace(config, loop=replace(config.loop, **loop)))
    return system, [system.process(f) for f in frames], system.finish()


def errors_m(camera, poses):
    true = se3.inverse(camera[0]) @ camera
    return np.linalg.norm(np.asarray(poses)[:, :3, 3] - true[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def closed(round_trip):
    """System, estimates and result of the whole turn."""
    return run(round_trip[1])


def test_a_loop_is_found_where_it_is_and_mends_the_trajectory(round_trip, closed):
    camera, frames = round_trip
    _, _, open_result = run(frames, enabled=False)
    system, estimates, result = closed
    assert open_result.loops is None
    assert len(result.loops) == len(system.loop_closer.loops) > 0
    true = se3.inverse(camera[result.loops.seen_before]) @ camera[result.loops.row]
    error = se3.inverse(true) @ result.loops.T_before_now
    # Of five seeds of the noise: 1.7 to 5.4 cm.
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.06
    before, after = (errors_m(camera, r.T_world_camera) for r in (open_result, result))
    assert after[-5:].mean() < before[-5:].mean() / 3
    assert after.mean() < 0.8 * before.mean()
    # The online trajectory goes on from the corrected map.
    assert errors_m(camera, [e.T_world_camera for e in estimates])[-1] < before[-1] / 3


def test_equal_frames_give_equal_bytes_beyond_a_loop(round_trip, closed):
    _, frames = round_trip
    again = run(frames)[2]
    assert closed[2].T_world_camera.tobytes() == again.T_world_camera.tobytes()
    assert closed[2].points_world.tobytes() == again.points_world.tobytes()


def test_where_no_place_comes_again_no_loop_is_closed(round_trip):
    _, frames = round_trip
    _, _, result = run(frames[:ROUND - 8], consistent=1)
    assert len(result.loops) == 0


def test_a_camera_uncovered_at_a_place_of_long_ago_is_found_there(round_trip):
    """Half a turn, 60 black frames, then a view from the beginning."""
    camera, frames = round_trip
    half = frames[:ROUND // 2]
    dark = [replace(half[-1], rgb=np.zeros((H, W, 3), np.uint8), index=len(half) + i,
                    stamp_s=half[-1].stamp_s + 0.1 * (1 + i)) for i in range(60)]
    later = [replace(frames[k], index=len(half) + 60 + i,
                     stamp_s=dark[-1].stamp_s + 0.1 * (1 + i)) for i, k in enumerate((1, 2, 3))]
    _, estimates, _ = run([*half, *dark, *later])
    assert all(e.status == Status.LOST for e in estimates[len(half):len(half) + 60])
    assert [e.status for e in estimates[-3:]] == [Status.TRACKED] * 3
    true = se3.inverse(camera[0]) @ camera[1:4]
    found = np.array([e.T_world_camera for e in estimates[-3:]])
    assert np.linalg.norm((found - true)[:, :3, 3], axis=1).max() < 0.1


def test_a_loop_is_kept_as_the_corrected_map_has_it(closed):
    system, _, result = closed
    loop = system.loop_closer.loops[0]
    a, b = loop.old.number, loop.keyframe.number
    # Later keyframes may move both a little.
    apart = se3.inverse(system.map.pose(a)) @ system.map.pose(b)
    assert np.linalg.norm((se3.inverse(apart) @ loop.T_old_keyframe)[:3, 3]) < 0.01
    assert np.array_equal(result.loops.T_before_now[0], loop.T_old_keyframe)


def test_a_gap_is_spread_over_the_way_between_the_ends_of_a_loop():
    T = np.repeat(np.eye(4)[None], 12, 0)
    T[:, 0, 3] = np.arange(12.0)
    back = se3.exp(np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    out = bent(T, 0, 10, back)
    assert np.allclose(out[0], T[0])
    assert np.allclose(out[10], back, atol=1e-6)
    assert np.allclose(out[5, :3, 3], [0.0, 0.0, 0.0], atol=1e-5)
    assert np.allclose(se3.inverse(out[10]) @ out[11], se3.inverse(T[10]) @ T[11], atol=0.11)


def test_coverage_counts_cells():
    assert covered(np.zeros((5, 2))) == 1 / 48
    everywhere = np.stack(np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40)), -1)
    assert covered(everywhere.reshape(-1, 2)) == 1.0


def test_a_feature_held_against_another_landmark_is_a_corner_again():
    n = 3
    whitening = np.array([[20.0, 3.0, 20.0, 500.0], [2.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 700.0]])
    points = KeyPoints(np.zeros((n, 2)), np.array([0, 2, 1], np.int32), np.zeros(n),
                       np.zeros((n, 32), np.uint8), np.ones(n), whitening)
    loose = Features(points, no_lines()).of_any_landmark(1.2).points.whitening
    sigma = np.sqrt(2.0 / 12.0)
    assert np.allclose(loose[0], [1 / sigma, 0.0, 1 / sigma, 500.0])
    assert np.allclose(loose[1], [1 / (1.44 * sigma), 0.0, 1 / (1.44 * sigma), 0.0])
    assert np.allclose(loose[2], whitening[2])         # as detected before, as detected now
    plain = Features(replace(points, whitening=None), no_lines())
    assert plain.of_any_landmark(1.2) is plain


def blank_keyframe(map_, T):
    nothing = np.zeros(0, np.int64)
    return map_.add_keyframe(len(map_.keyframes), T, Features(no_points(), no_lines()), nothing,
                             nothing)


def test_a_loop_ties_what_its_keyframes_hang_on_once_they_are_gone():
    map_ = PointLineMap()
    poses = se3.exp(np.random.default_rng(4).normal(size=(5, 6)) * 0.3)
    keyframes = [blank_keyframe(map_, T) for T in poses]
    loop = Loop(keyframes[4], keyframes[1], se3.inverse(poses[1]) @ poses[4], 60)
    for number in (1, 4):
        map_.drop_keyframe(keyframes[number])
    a, b, T_a_b = between_living(map_, loop)
    assert keyframes[a].alive
    assert keyframes[b].alive
    assert np.allclose(T_a_b, se3.inverse(poses[a]) @ poses[b])
    # What is told of the loop stays what was found: of the frames it was found in.
    closer = LoopCloser(PoseTracker(bw.CAMERA, default_config("dpl")))
    closer.loops.append(loop)
    told = closer.closed()
    assert (told.row[0], told.seen_before[0]) == (4, 1)
    assert np.allclose(told.T_before_now[0], loop.T_old_keyframe)


def test_after_a_camera_was_found_again_frames_lean_on_a_keyframe_of_that_place(round_trip):
    _, frames = round_trip
    half = frames[:ROUND // 2]
    system, *_ = run(half)
    assert system.reference.keyframe.frame > 10
    dark = replace(half[-1], rgb=np.zeros((H, W, 3), np.uint8), index=len(half),
                   stamp_s=half[-1].stamp_s + 0.1)
    assert system.process(dark).status == Status.LOST
    back = replace(frames[1], index=len(half) + 1, stamp_s=dark.stamp_s + 0.1)
    assert system.process(back).status == Status.TRACKED
    assert system.reference.keyframe.frame < 10
    # It goes where that place goes.
    move = se3.exp(np.array([0.0, 0.2, 0.0, 1.0, 0.0, 0.0]))
    before = system.finish().T_world_camera[-1]
    system.reference.keyframe.T_world_camera = move @ system.reference.keyframe.T_world_camera
    assert np.allclose(system.finish().T_world_camera[-1], move @ before, atol=1e-9)


def test_a_place_that_is_refused_leaves_no_trace_in_the_map(round_trip):
    _, frames = round_trip
    config = default_config("orb")
    system = slam.make("orb", bw.CAMERA, replace(config, track=replace(
        config.track, relocalise_inliers=100_000)))
    for frame in frames[:6]:
        system.process(frame)
    dark = replace(frames[5], rgb=np.zeros((H, W, 3), np.uint8), index=6, stamp_s=0.6)
    system.process(dark)
    points = system.map.points
    before = points.found.copy(), points.visible.copy()
    assert system.process(replace(frames[5], index=7, stamp_s=0.7)).status == Status.LOST
    assert np.array_equal(points.found, before[0])
    assert np.array_equal(points.visible, before[1])
