"""The rigid motion that best fits the scene flow of what is seen of an object."""

from __future__ import annotations

import numpy as np
import pytest

from simbench.metrics.association import owners
from simbench.metrics.deforming import RigidFits, rigid_fit_metrics
from simbench.metrics.objects import object_errors
from simbench.types import Edges3D, FlowTruth, FrameTruth, ObjectInfo, SceneLayout
from slam.geometry import se3
from slam.geometry.camera import back_project
from slam.types import Frame, FrameEstimate
from synthetic import CAMERA, exact_camera, exact_motions, world

TRUTH = world()
H = se3.exp(np.array([0.02, -0.01, 0.05, 0.1, 0.0, -0.05]))


class OneObject:
    """An object (id 1) in the middle of the image that moves by H, or by halves apart."""

    has_images = True

    def __init__(self, spread_m: float, rigid: bool = False) -> None:
        edges = Edges3D(np.zeros(0, np.int32), np.zeros((0, 2, 3)))
        self.layout = SceneLayout(CAMERA, (ObjectInfo(1, "thing", 1, rigid),),
                                  np.array([0, 1]), edges)
        self.instances = np.zeros((48, 64), np.int32)
        self.instances[10:30, 20:40] = 1
        self.depth = np.linspace(2.0, 5.0, 48 * 64).reshape(48, 64).astype(np.float32)
        self.spread_m = spread_m

    def frame(self, k: int) -> FrameTruth:
        return FrameTruth(k, 0.1 * k, TRUTH.T_world_camera[k], np.repeat(np.eye(4)[None], 2, 0),
                          self.depth, self.instances, self.instances)

    def flow(self, i: int, j: int) -> FlowTruth:
        v, u = np.mgrid[:48, :64]
        points = se3.transform_points(TRUTH.T_world_camera[i], back_project(
            CAMERA, np.stack([u, v], -1).reshape(-1, 2), self.depth.ravel()))
        moved = se3.transform_points(H, points)
        moved[:, 2] += np.where(u.ravel() % 2 == 0, self.spread_m, -self.spread_m)
        none = np.zeros((48, 64), bool)
        return FlowTruth(np.zeros((48, 64, 2), np.float32),
                         (moved - points).reshape(48, 64, 3).astype(np.float32), ~none, none,
                         none, none)


def look(fits: RigidFits, k: int) -> None:
    grey = np.zeros((48, 64, 3), np.uint8)
    frame = Frame(k, 0.1 * k, grey, np.ones((48, 64), np.float32), CAMERA)
    fits(frame, FrameEstimate(k, 0.1 * k, np.eye(4), np.eye(4)))


@pytest.mark.parametrize("spread_m", [0.0, 0.01])
def test_the_fit_is_the_common_motion_of_parts_that_move_apart(spread_m):
    fits = RigidFits(OneObject(spread_m))
    look(fits, 0)
    look(fits, 4)
    assert list(fits.H_world) == [(1, 4)]
    middle = se3.transform_points(TRUTH.T_world_camera[3], back_project(
        CAMERA, np.array([[29.5, 19.5]]), np.array([3.2])))
    gap = se3.transform_points(fits.H_world[1, 4], middle) - se3.transform_points(H, middle)
    assert np.linalg.norm(gap) < (1e-6 if spread_m == 0 else 0.1 * spread_m)


def test_rigid_objects_and_recordings_have_none():
    fits, none = RigidFits(OneObject(0.0, rigid=True)), RigidFits(None)
    look(fits, 4)
    look(none, 4)
    assert not fits.H_world
    assert not none.H_world


def test_errors_against_the_fit_are_those_of_the_estimate():
    camera = exact_camera(TRUTH)
    motions = exact_motions(TRUTH, camera, {1: 7})
    owner = owners(motions.track, motions.stands_on)
    errors = object_errors(motions, owner, camera, TRUTH, True)
    L = TRUTH.objects[1].T_world_object
    P = se3.exp(np.array([0.0, 0.0, np.radians(0.5), 0.02, 0.0, 0.0]))
    fits = {(1, k): L[k] @ P @ se3.inverse(L[k - 1]) for k in (3, 9)}
    out = rigid_fit_metrics(fits, errors, motions, camera, TRUTH)
    assert set(out) == {"1"}
    assert out["1"]["E_R_rigid_fit"] == pytest.approx(0.5, rel=1e-6)
    assert out["1"]["E_t_rigid_fit"] == pytest.approx(np.linalg.norm(P[:3, 3]), rel=1e-6)
