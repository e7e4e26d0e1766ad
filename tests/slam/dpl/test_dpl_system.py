"""DPL-SLAM on small ray-cast scenes: poses, movers, bad frames, a covered camera."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import box_world as bw
import slam
from slam.geometry import se3
from slam.types import Boxes2D, Status

FRAMES = 12
H, W = bw.CAMERA.height, bw.CAMERA.width


def filmed(boxes):
    camera = bw.hand_held(FRAMES)
    return camera, [replace(f, flow=None) for f in bw.sequence(camera, boxes)]


@pytest.fixture(scope="module")
def scene():
    """A camera in a room where nothing moves."""
    return filmed({3: bw.Box((0.45, 0.35, 0.4), bw.standing(-0.9, 0.1, 0.2, FRAMES)),
                   5: bw.Box((0.4, 0.5, 0.4), bw.standing(1.0, 0.4, 0.5, FRAMES))})


@pytest.fixture(scope="module")
def crossing():
    """A camera in a room where a box crosses the view, filling two fifths of it."""
    return filmed({3: bw.Box((0.9, 0.8, 0.4),
                             bw.moving(-0.9, 0.1, 0.2, FRAMES, (0.08, 0.0, 0.0)))})


def with_boxes(frame):
    rows, columns = np.nonzero(frame.instance_id)
    corners = np.array([[columns.min(), rows.min(), columns.max(), rows.max()]], float)
    return replace(frame, boxes=Boxes2D(corners, np.ones(1), np.zeros(1, int)), instance_id=None)


def run(frames, name="dpl"):
    system = slam.make(name, bw.CAMERA)
    return system, [system.process(f) for f in frames]


def errors_m(camera, poses):
    true = se3.inverse(camera[0]) @ camera[:len(poses)]
    return np.linalg.norm((se3.inverse(true) @ np.array(poses))[:, :3, 3], axis=1)


def test_a_room_that_stands_is_tracked_and_mapped(scene):
    camera, frames = scene
    system, estimates = run(frames)
    assert [e.status for e in estimates] == [Status.FIRST] + [Status.TRACKED] * (FRAMES - 1)
    assert errors_m(camera, [e.T_world_camera for e in estimates]).max() < 0.04
    result = system.finish()
    assert errors_m(camera, result.T_world_camera).max() < 0.04
    x, y, z = np.abs(se3.transform_points(camera[0], result.points_world)).T / bw.ROOM[:, None]
    assert np.mean(np.maximum(np.maximum(x, y), z) < 1.1) > 0.95


def test_a_mover_with_a_box_is_left_out_and_without_removal_leads_astray(crossing):
    camera, frames = crossing
    _, estimates = run([with_boxes(f) for f in frames])
    clean = errors_m(camera, [e.T_world_camera for e in estimates])
    plain = errors_m(camera, [e.T_world_camera for e in run(frames, "orb")[1]])
    assert clean.max() < 0.1
    assert clean.mean() < 0.2 * plain.mean()      # which follows the box
    on_box = [np.mean(f.instance_id[np.rint(e.points.uv_px[:, 1]).astype(int),
                                    np.rint(e.points.uv_px[:, 0]).astype(int)] > 0)
              for f, e in list(zip(frames, estimates, strict=True))[2:]]
    assert np.mean(on_box) < 0.05


def test_presets_have_lines_or_not(scene):
    _, frames = scene
    assert run(frames[:3], "orb")[1][2].inliers["lines"] == 0
    system, estimates = run(frames[:3], "orb-lines")
    assert estimates[2].inliers["lines"] > 0
    assert len(system.finish().lines_world) > 0


def test_equal_frames_give_equal_bytes(scene):
    _, frames = scene
    first, again = (run(frames[:6])[0].finish() for _ in range(2))
    assert_array_equal(first.T_world_camera, again.T_world_camera)
    assert_array_equal(first.points_world, again.points_world)


BAD = 5
NOISE = np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)
SPOILT = {
    "black": {"rgb": np.zeros((H, W, 3), np.uint8)},
    "noise": {"rgb": NOISE},
    "no depth": {"depth_m": np.zeros((H, W), np.float32)},
    "NaN depth": {"depth_m": np.full((H, W), np.nan, np.float32)},
    "far depth": {"depth_m": np.full((H, W), 65535.0, np.float32)},
    "tiny depth": {"depth_m": np.full((H, W), 1e-42, np.float32)},
    "negative depth": {"depth_m": np.full((H, W), -3.0, np.float32)},
    "500 boxes": {"boxes": Boxes2D(np.random.default_rng(0).uniform(-50, 300, (500, 4)),
                                   np.ones(500), np.zeros(500, int))},
    "bad boxes": {"boxes": Boxes2D(np.array([[np.nan, 0, 5, 5], [5, 5, 5, 5], [-1e9, 0, 1e9, 1e9],
                                             [np.inf, 0, 1, 1]]), np.ones(4), np.zeros(4, int))},
    "no boxes": {"boxes": Boxes2D(np.zeros((0, 4)), np.zeros(0), np.zeros(0, int))},
    "stamp in the past": {"stamp_s": -5.0},
    "stamp far ahead": {"stamp_s": 1e4},
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_frame_is_answered_and_the_run_goes_on(scene, name):
    camera, frames = scene
    given = list(frames)
    given[BAD] = replace(given[BAD], **SPOILT[name])
    system, estimates = run(given)
    assert all(np.isfinite(e.T_world_camera).all() for e in estimates)
    assert all(e.reason for e in estimates if e.status == Status.LOST)
    assert all(e.status == Status.TRACKED for e in estimates[BAD + 2:])
    assert errors_m(camera, [e.T_world_camera for e in estimates])[BAD + 2:].max() < 0.05
    assert len(system.finish().stamps_s) == FRAMES


def test_a_camera_that_is_covered_finds_its_way_back(scene):
    """60 black frames, then a view from before: lost, and found where it really is."""
    camera, frames = scene
    dark = [replace(frames[6], rgb=np.zeros((H, W, 3), np.uint8), index=7 + i,
                    stamp_s=frames[6].stamp_s + 0.1 * (1 + i)) for i in range(60)]
    later = [replace(frames[k], index=67 + i, stamp_s=dark[-1].stamp_s + 0.1 * (1 + i))
             for i, k in enumerate((3, 2, 1))]
    _, estimates = run([*frames[:7], *dark, *later])
    assert all(e.status == Status.LOST for e in estimates[7:67])
    assert [e.status for e in estimates[67:]] == [Status.TRACKED] * 3
    true = se3.inverse(camera[0]) @ camera[[3, 2, 1]]
    found = np.array([e.T_world_camera for e in estimates[67:]])
    assert np.linalg.norm((se3.inverse(true) @ found)[:, :3, 3], axis=1).max() < 0.05


def test_uncovered_where_nothing_is_known_a_new_part_of_the_map_begins(scene):
    _, frames = scene
    wall = cv2.GaussianBlur(NOISE, (0, 0), 2.0)
    wall = cv2.normalize(wall, None, 0, 255, cv2.NORM_MINMAX)
    other = [replace(frames[0], rgb=wall, depth_m=np.full((H, W), 2.0, np.float32), index=4 + i,
                     stamp_s=frames[3].stamp_s + 0.1 * (i + 1), instance_id=None)
             for i in range(20)]
    system, estimates = run([*frames[:4], *other])
    status = [e.status for e in estimates]
    assert status[4] == Status.LOST
    assert status[-1] == Status.TRACKED
    begun = next(k for k in system.map.keyframes if k.part == 1)
    begun.T_world_camera = se3.exp(np.array([0.1, 0.0, 0.2, 1.0, 2.0, 0.5])) @ begun.T_world_camera
    assert_allclose(system.finish().T_world_camera[begun.frame], begun.T_world_camera, atol=1e-9)


def test_a_frame_that_repeats_stands_still(scene):
    _, frames = scene
    repeated = [replace(frames[4], index=5), replace(frames[4], index=6)]
    _, estimates = run([*frames[:5], *repeated])
    for e in estimates[5:]:
        assert e.status == Status.TRACKED
        assert np.abs(se3.log(e.T_previous_camera)).max() < 0.01


def test_a_map_of_what_was_seen_before_stops_growing(scene):
    """The same frames forth and back: rows of landmarks, not only the living, come to an end."""
    _, frames = scene
    there_and_back = [*range(FRAMES), *range(FRAMES - 2, 0, -1)]
    system, rows = slam.make("dpl", bw.CAMERA), []
    for number in range(12 * len(there_and_back)):
        system.process(replace(frames[there_and_back[number % len(there_and_back)]],
                               index=number, stamp_s=number / 30.0))
        if (number + 1) % len(there_and_back) == 0:
            rows.append(system.map.points.count + system.map.lines.count)
    assert len(system.map.keyframes) > sum(k.alive for k in system.map.keyframes)
    assert rows[-1] <= 1.05 * rows[6]
