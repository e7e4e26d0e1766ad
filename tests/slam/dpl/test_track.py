"""The pose that a frame's pairs support, and who has a say in it."""

import numpy as np
import pytest

from slam.dpl.config import DplConfig
from slam.dpl.features import Features, KeyPoints, no_lines
from slam.dpl.track import Pairs, PoseTracker
from slam.geometry import se3
from slam.geometry.camera import back_project, project
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 300.0, 160.0, 120.0, 320, 240)
TRUE = se3.exp(np.array([0.0, 0.01, 0.0, 0.02, 0.0, 0.6]))     # the camera's step
BOX = np.array([[100.0, 60.0, 220.0, 200.0]])
NOTHING_HELD = np.zeros((0, 2, 3)), np.zeros(0, np.int64)


def street(outside, mover, parked, rng):
    """Pairs of one step: a mover before the camera that drives at its pace, all else standing."""
    uv = rng.uniform([5.0, 5.0], [315.0, 235.0], (4000, 2))
    in_box = ((uv > BOX[0, :2] + 12.0) & (uv < BOX[0, 2:] - 12.0)).all(axis=1)
    beside = ((uv < BOX[0, :2] - 12.0) | (uv > BOX[0, 2:] + 12.0)).any(axis=1)
    before = np.concatenate([uv[beside][:outside], uv[in_box][: mover + parked]])
    depth = np.concatenate([rng.uniform(5.0, 40.0, outside), np.full(mover, 6.0),
                            rng.uniform(8.0, 20.0, parked)])
    xyz = back_project(CAMERA, before, depth)
    local = se3.transform_points(se3.inverse(TRUE), xyz)
    moves = slice(outside, outside + mover)
    local[moves] = xyz[moves]
    n = len(xyz)
    seen = project(CAMERA, local) + rng.normal(scale=0.3, size=(n, 2))
    points = KeyPoints(seen, np.zeros(n, np.int32), np.zeros(n), np.zeros((n, 32), np.uint8),
                       local[:, 2])
    return Pairs(xyz, np.arange(n), *NOTHING_HELD), Features(points, no_lines())


def off_m(T):
    return np.linalg.norm((se3.inverse(TRUE) @ T)[:3, 3])


def test_a_mover_in_its_box_does_not_outvote_the_world():
    rng = np.random.default_rng(0)
    pairs, features = street(120, 400, 30, rng)
    tracker = PoseTracker(CAMERA, DplConfig())
    assert off_m(tracker.fit(np.eye(4), pairs, features).T_world_camera) > 0.3
    fit = tracker.fit_beside(BOX, np.eye(4), pairs, features)
    assert off_m(fit.T_world_camera) < 0.02
    assert not fit.point_fits[120:520].any()
    assert fit.point_fits[:120].mean() > 0.9
    assert fit.point_fits[520:].mean() > 0.9
    assert fit.asked < 160
    assert fit.share > 0.9


@pytest.mark.parametrize("boxes", [np.zeros((0, 4)), np.array([[0.0, 0.0, 320.0, 240.0]])])
def test_with_no_boxes_or_nothing_outside_them_all_have_a_say(boxes):
    pairs, features = street(150, 0, 30, np.random.default_rng(1))
    tracker = PoseTracker(CAMERA, DplConfig())
    whole, beside = (tracker.fit(np.eye(4), pairs, features),
                     tracker.fit_beside(boxes, np.eye(4), pairs, features))
    np.testing.assert_array_equal(beside.T_world_camera, whole.T_world_camera)
    assert beside.asked == len(pairs.point) == whole.asked
