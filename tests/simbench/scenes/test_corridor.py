"""Corridor-v0: hardly any texture, everybody in a lane of their own, a trolley that passes."""

from __future__ import annotations

import itertools

import cv2
import mujoco
import numpy as np
import pytest

from simbench.render import make_renderer
from simbench.scenes_builtin.corridor_shell import HEIGHT_M, LENGTH_M, WIDTH_M
from simbench.world import make_world
from slam.geometry import se3

SMALL = (80, 60)


def corridor(seed=0, size=SMALL, **dials):
    return make_world("Corridor-v0", seed, dials, size)


def body(world, name):
    return mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, name)


@pytest.mark.parametrize(("dials", "until_s"), [
    ({"people": 3, "undetected": 1}, 10.0), ({"camera_speed": 0.0, "speed": 3.0}, 70.0),
    ({"camera_speed": 3.0, "speed": 0.0}, 30.0)])
def test_nobody_runs_into_anybody_or_through_a_wall(dials, until_s):
    world = corridor(1, **dials)
    names = [f"person {n + 1}" for n in range(dials.get("people", 2))] + ["trolley"]
    names += [f"kicked box {n}" for n in (1, 2) if "undetected" in dials]
    parts = [body(world, name) for name in names]
    for time_s in np.arange(0.0, until_s, until_s / 150.0):
        world.advance_to(float(time_s))
        eye, at = world.T_world_camera[:3, 3], world.T_world_part[parts][:, :3, 3]
        assert 0.5 < eye[0] < LENGTH_M - 0.5
        assert abs(eye[1]) < WIDTH_M / 2.0 - 0.4
        assert 1.2 < eye[2] < 1.75
        assert np.all((at[:, 0] > 0.3) & (at[:, 0] < LENGTH_M - 0.3))
        assert np.all(np.abs(at[:, 1]) < WIDTH_M / 2.0 - 0.12)
        upright = at[[not name.startswith("kicked") for name in names], :2]
        assert np.linalg.norm(upright - eye[:2], axis=1).min() > 0.8
        # Those who push walk 0.86 m behind their trolley's middle; boxes lie by the walls.
        gaps = [np.linalg.norm(a - b) for a, b in itertools.combinations(at[:, :2], 2)]
        assert min(gaps) > 0.35


def test_a_trolley_comes_and_passes_and_somebody_walks_ahead():
    world = corridor()
    trolley, ahead = body(world, "trolley"), body(world, "person 2")
    depth = []
    for time_s in np.arange(0.0, 10.0, 0.5):
        world.advance_to(float(time_s))
        T_camera_world = se3.inverse(world.T_world_camera)
        depth.append((T_camera_world @ world.T_world_part[[trolley, ahead]])[:, 2, 3])
    depth = np.array(depth)
    assert 8.0 < depth[0, 0] < 14.0
    assert depth[-1, 0] < 0.0
    assert np.all((depth[:, 1] > 2.5) & (depth[:, 1] < 7.0))


def test_most_of_the_picture_is_plain_though_there_are_long_edges():
    plain = {}
    for texture in (0.12, 1.0):
        world = corridor(0, (320, 240), people=0, texture=texture)
        renderer = make_renderer("mujoco", world)
        grey = cv2.cvtColor(renderer.rgb(world), cv2.COLOR_RGB2GRAY)
        renderer.close()
        plain[texture] = (grey.reshape(15, 16, 20, 16).std(axis=(1, 3)) < 3.0).mean()
        ends = cv2.createLineSegmentDetector().detect(grey)[0].reshape(-1, 2, 2)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        assert length[length > 20.0].sum() > 1000.0     # px
    assert plain[0.12] > 0.4
    assert plain[1.0] < 0.1


def test_who_is_an_object():
    def rigid(**dials):
        return {o.name: o.rigid for o in corridor(**dials).layout.objects}

    assert rigid() == {"person 1": False, "person 2": False, "trolley": True}
    assert rigid(people=0, undetected=1) == {}
    ceiling = corridor(people=0).layout.edges.endpoints_part[..., 2].max()
    assert ceiling == pytest.approx(HEIGHT_M, abs=1e-4)   # edges are joined by rounding
