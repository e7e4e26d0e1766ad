"""Whatever a frame holds, `process` answers, says so where it is lost, and goes on."""

from dataclasses import replace

import numpy as np
import pytest

import box_world as bw
import slam
from slam.config import SdplConfig
from slam.geometry import se3
from slam.types import FlowField, Frame, Intrinsics, Status

H, W = bw.CAMERA.height, bw.CAMERA.width
BAD = 4                     # the frame that is spoilt


def depth(value):
    return {"depth_m": np.full((H, W), value, np.float32)}


def half_depth(value):
    def spoil(frame):
        out = np.array(frame.depth_m)
        out[:, ::2] = value
        return {"depth_m": out}
    return spoil


def masks(make):
    return lambda frame: {"instance_id": make(np.array(frame.instance_id)).astype(np.int32)}


def grains(labels, size):
    """A mask for each square of `size` pixels, their numbers far apart."""
    rows, columns = np.mgrid[:H, :W] // size
    return (rows * 1000 + columns + 1) * 997


def with_tiny_object(labels):
    labels[60, 80:83] = 77
    return labels


def noise_image(frame):
    return {"rgb": np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)}


def nan_flow(frame):
    return {"flow": FlowField(np.full((H, W, 2), np.nan, np.float32))}


def wild_flow(frame):
    values = np.random.default_rng(1).normal(scale=200, size=(H, W, 2)).astype(np.float32)
    return {"flow": FlowField(values)}


def half_flow(frame):
    values = np.array(frame.flow.flow_px)
    values[:, ::2], values[::5] = np.inf, np.nan
    return {"flow": FlowField(values)}


# What a frame becomes, and whether it can still be tracked (None: either is right).
SPOILT = {
    "black image": (lambda f: {"rgb": np.zeros((H, W, 3), np.uint8), "flow": None}, False),
    "white image": (lambda f: {"rgb": np.full((H, W, 3), 255, np.uint8), "flow": None}, False),
    "noise image": (lambda f: noise_image(f) | {"flow": None}, False),
    "black image, flow given": (lambda f: {"rgb": np.zeros((H, W, 3), np.uint8)}, True),
    "no depth": (lambda f: depth(0.0), False),
    "NaN depth": (lambda f: depth(np.nan), False),
    "infinite depth": (lambda f: depth(np.inf), False),
    "negative depth": (lambda f: depth(-3.0), False),
    "65535 depth": (lambda f: depth(65535.0), None),
    "tiny depth": (lambda f: depth(1e-42), False),
    "half NaN depth": (half_depth(np.nan), True),
    "half 65535 depth": (half_depth(65535.0), True),
    "no masks": (lambda f: {"instance_id": None}, None),
    "no labels": (masks(np.zeros_like), None),
    "three pixels": (masks(with_tiny_object), True),
    "300 masks": (masks(lambda m: grains(m, 8)), None),
    "19200 masks": (masks(lambda m: grains(m, 1)), None),
    "huge labels": (masks(lambda m: np.where(m > 0, 2**31 - 1 - m, 0)), True),
    "negative labels": (masks(lambda m: np.where(m == 0, -1, m)), True),
    "one mask over all": (masks(np.ones_like), None),
    "NaN flow": (nan_flow, False),
    "no flow valid": (lambda f: {"flow": FlowField(f.flow.flow_px, np.zeros((H, W), bool))}, False),
    "wild flow": (wild_flow, False),
    "half the flow": (half_flow, True),
    "stamp of the frame before": (lambda f: {"stamp_s": f.stamp_s - 0.1}, None),
    "stamp in the past": (lambda f: {"stamp_s": f.stamp_s - 5.0}, None),
    "stamp far ahead": (lambda f: {"stamp_s": f.stamp_s + 1e4}, None),
}


def pose_error_m(camera, estimate, k):
    true = se3.inverse(camera[0]) @ camera[k]
    return np.linalg.norm((se3.inverse(true) @ estimate.T_world_camera)[:3, 3])


@pytest.mark.parametrize("own_flow", [False, True], ids=["given", "own"])
@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_frame_is_answered_and_the_run_goes_on(two_boxes, name, own_flow):
    spoil, tracked = SPOILT[name]
    camera, _, frames = two_boxes
    changed = spoil(frames[BAD])
    if own_flow and "flow" in changed and "rgb" not in changed:
        pytest.skip("flow is not given here")
    given = [replace(f, flow=None) if own_flow else f for f in frames]
    given[BAD] = replace(given[BAD], **{k: v for k, v in changed.items()
                                        if not (own_flow and k == "flow")})
    system = slam.make("sdpl", bw.CAMERA)
    estimates = [system.process(f) for f in given]
    status = [e.status for e in estimates]
    assert status[:BAD] == [Status.FIRST] + [Status.TRACKED] * (BAD - 1)
    if tracked is not None and not (own_flow and name == "black image, flow given"):
        assert status[BAD] == (Status.TRACKED if tracked else Status.LOST), estimates[BAD].reason
    # A lost frame leaves the good one before it in place; one that was tracked but is of no use
    # to its successors is found out by the second of them.
    again = BAD + (2 if status[BAD] == Status.LOST else 3)
    assert all(s == Status.TRACKED for s in status[again:]), [e.reason for e in estimates]
    assert all(e.reason for e in estimates if e.status == Status.LOST)
    for k, e in enumerate(estimates):
        assert np.isfinite(e.T_world_camera).all()
        limit = 0.15 if Status.LOST in status[:k + 1] else 0.01
        assert pose_error_m(camera, e, k) < limit, k
    result = system.finish()
    assert len(result.stamps_s) == len(frames)
    assert np.isfinite(result.T_world_camera).all()


@pytest.mark.parametrize("name", ["black image", "no depth", "NaN depth", "300 masks",
                                  "one mask over all", "65535 depth"])
def test_a_spoilt_first_frame_costs_two_frames_at_most(two_boxes, name):
    spoil, _ = SPOILT[name]
    _, _, frames = two_boxes
    given = [replace(frames[0], **spoil(frames[0])), *(replace(f, flow=None) for f in frames[1:])]
    system = slam.make("sdpl", bw.CAMERA)
    status = [system.process(f).status for f in given]
    assert status[0] == Status.FIRST
    assert status.count(Status.LOST) <= 2
    assert all(s == Status.TRACKED for s in status[3:])


def test_a_missing_frame_is_bridged_by_our_own_flow(two_boxes):
    """Flow that comes with frame 5 starts at frame 4, which was never seen: it is not used."""
    camera, _, frames = two_boxes
    system = slam.make("sdpl", bw.CAMERA)
    kept = [f for f in frames if f.index != BAD]
    estimates = {f.index: system.process(f) for f in kept}
    assert all(e.status == Status.TRACKED for k, e in estimates.items() if k > 0)
    assert all(pose_error_m(camera, e, k) < 0.01 for k, e in estimates.items())
    step = se3.inverse(camera[BAD - 1]) @ camera[BAD + 1]
    error = se3.inverse(estimates[BAD + 1].T_previous_camera) @ step
    assert np.linalg.norm(error[:3, 3]) < 0.005


@pytest.mark.parametrize("share", [0.05, 0.2])
@pytest.mark.parametrize("own_flow", [False, True], ids=["given", "own"])
def test_depth_full_of_small_holes_is_no_obstacle(two_boxes, own_flow, share):
    camera, _, frames = two_boxes
    rng = np.random.default_rng(3)
    given = [replace(f, depth_m=np.where(rng.random((H, W)) < share, 0, f.depth_m)
                     .astype(np.float32), flow=None if own_flow else f.flow) for f in frames[:6]]
    system = slam.make("sdpl", bw.CAMERA)
    estimates = [system.process(f) for f in given]
    assert all(e.status == Status.TRACKED for e in estimates[1:]), [e.reason for e in estimates]
    assert bw.camera_errors(camera, estimates)[0].max() < 5e-3


def test_nothing_but_black_is_lost_all_along_and_answered():
    system = slam.make("sdpl", bw.CAMERA)
    black = np.zeros((H, W, 3), np.uint8)
    estimates = [system.process(Frame(k, k / 10, black, np.full((H, W), 3.0, np.float32),
                                      bw.CAMERA)) for k in range(25)]
    assert estimates[0].status == Status.FIRST
    assert all(e.status == Status.LOST and e.reason for e in estimates[1:])
    assert all(np.isfinite(e.T_world_camera).all() for e in estimates)
    assert len(system.finish().status) == 25


def test_tracking_starts_afresh_after_a_long_blackout(two_boxes):
    camera, _, frames = two_boxes
    config = SdplConfig()
    dark = config.start.give_up_after + 2
    black = np.zeros((H, W, 3), np.uint8)
    system = slam.make("sdpl", bw.CAMERA)
    given = [replace(f, flow=None) for f in frames[:3]]
    given += [replace(frames[3], index=3 + k, stamp_s=frames[3].stamp_s + k / 10, rgb=black,
                      flow=None) for k in range(dark)]
    given += [replace(f, index=f.index + dark, stamp_s=f.stamp_s + dark / 10, flow=None)
              for f in frames[4:]]
    estimates = [system.process(f) for f in given]
    status = [e.status for e in estimates]
    assert status[1:3] == [Status.TRACKED] * 2
    assert Status.TRACKED not in status[3:3 + dark]
    assert status[-3:] == [Status.TRACKED] * 3
    step = se3.inverse(camera[-2]) @ camera[-1]
    error = se3.inverse(estimates[-1].T_previous_camera) @ step
    assert np.linalg.norm(error[:3, 3]) < 2e-3


def test_finish_without_a_frame_and_with_one():
    system = slam.make("sdpl", bw.CAMERA)
    assert len(system.finish().stamps_s) == 0
    system = slam.make("sdpl", bw.CAMERA)
    system.process(bw.sequence(bw.hand_held(1), {})[0])
    result = system.finish()
    assert result.status == (Status.FIRST,)
    assert result.T_world_camera.shape == (1, 4, 4)


@pytest.mark.parametrize(("width", "height"), [(80, 60), (161, 121), (320, 64)])
def test_images_of_any_size_are_tracked(width, height):
    intrinsics = Intrinsics(0.9 * width, 0.9 * width, (width - 1) / 2, (height - 1) / 2, width,
                            height)
    camera = bw.hand_held(4)
    box = {2: bw.Box((0.5, 0.4, 0.4), bw.moving(-0.3, 0.1, 0.0, 4, (0.05, 0.0, 0.0)))}
    for with_flow in (True, False):
        frames = bw.sequence(camera, box, intrinsics, with_flow=with_flow)
        system = slam.make("sdpl", intrinsics)
        estimates = [system.process(f) for f in frames]
        assert all(np.isfinite(e.T_world_camera).all() for e in estimates)
        if with_flow:
            assert all(e.status == Status.TRACKED for e in estimates[1:])
            assert bw.camera_errors(camera, estimates)[0].max() < 0.01


@pytest.mark.parametrize("name", ["sdpl", "sdpl-batch", "dpl"])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (8, 8), (11, 40), (40, 11), (400, 20)])
def test_images_too_small_to_be_tracked_are_answered(name, width, height):
    intrinsics = Intrinsics(0.9 * width, 0.9 * width, (width - 1) / 2, (height - 1) / 2, width,
                            height)
    frames = bw.sequence(bw.hand_held(4), {}, intrinsics, with_flow=False)
    system = slam.make(name, intrinsics)
    estimates = [system.process(f) for f in frames]
    assert all(np.isfinite(e.T_world_camera).all() for e in estimates)
    assert all(e.reason for e in estimates if e.status == Status.LOST)
    assert len(system.finish().stamps_s) == len(frames)
