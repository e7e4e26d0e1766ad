"""Loop-v0: a way that closes, houses that can be told apart, people on the pavements."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from simbench.randomise import generator
from simbench.scenes_builtin.loop import Ego
from simbench.scenes_builtin.roadside import KERB_M, SIDEWALK_M
from simbench.scenes_builtin.town import ROAD_M
from simbench.world import make_world
from slam.geometry import se3

SMALL = (76, 24)
WIDTH_M, HEIGHT_M = 66.0, 52.0


def loop(seed=0, **dials):
    return make_world("Loop-v0", seed, dials, SMALL)


def drive(world, frames, every=1):
    """(K, 4, 4) cameras and (K, O, 4, 4) objects."""
    roots = [each.root_part for each in world.layout.objects]
    cameras, objects = [], []
    for k in range(0, frames, every):
        world.advance_to(k / world.fps)
        cameras.append(world.T_world_camera)
        objects.append(world.T_world_part[roots])
    return np.stack(cameras), np.stack(objects)


def test_the_camera_comes_back_the_way_it_went():
    sides = set()
    for seed in range(8):
        ego = Ego.draw(generator(seed, 3), 1.0)
        sides.add(ego.clockwise)
        cameras = np.stack([ego.camera(k / 10.0) for k in range(360)])
        step = np.linalg.norm(np.diff(cameras[:, :3, 3], axis=0), axis=1)
        assert 150.0 < step[:330].sum() < 300.0
        assert np.all((step > 0.3) & (step < 1.1))
        turned = se3.rotation_angle(se3.inverse(cameras[:-1])[:, :3, :3] @ cameras[1:, :3, :3])
        assert turned.max() < np.deg2rad(5.0)
        again = cameras[250:]
        apart = np.linalg.norm(again[:, None, :3, 3] - cameras[None, :100, :3, 3], axis=-1)
        near = np.argmin(apart, axis=1)
        angle = se3.rotation_angle(np.swapaxes(cameras[near, :3, :3], 1, 2) @ again[:, :3, :3])
        seen_again = (apart.min(axis=1) < 1.0) & (angle < np.deg2rad(5.0))
        assert 20 <= seen_again.sum() <= 70
    assert sides == {True, False}


def test_no_two_houses_look_alike():
    model = loop(2, objects=1, people=1).model
    facades = [m for m in range(model.nmat) if model.material(m).name.startswith("facade")]
    looks = {(tuple(model.mat_texid[m]), *np.round(model.mat_rgba[m], 3)) for m in facades}
    assert len(looks) == len(facades) > 40


@pytest.mark.parametrize("dials", [{"people": 12, "speed": 2.0, "objects": 8},
                                   {"camera_speed": 0.0, "speed": 3.0, "people": 2}])
def test_cars_keep_their_lanes_and_distances_and_people_their_pavements(dials):
    world = loop(1, **dials)
    cameras, poses = drive(world, 360, 4)
    names = [each.name for each in world.layout.objects]
    cars = [n for n, name in enumerate(names) if "car" in name]
    people = [n for n, name in enumerate(names) if name.startswith("person")]
    at = poses[..., :3, 3]
    for n in cars:
        others = [m for m in cars if m < n]
        gap = np.linalg.norm(at[:, n, None, :2] - at[:, others, :2], axis=-1)
        assert np.all(gap > 2.1)          # side by side, in lanes of their own
        beside = np.abs(np.einsum("kij,koj->koi", se3.inverse(poses[:, n]),
                                  poses[:, others][..., 3])[..., 1])
        assert np.all((gap > 4.7) | (beside > 1.95))
    assert np.linalg.norm(at[:, cars, :2] - cameras[:, None, :2, 3], axis=-1).min() > 2.2
    x, y = at[:, people, 0], at[:, people, 1]
    # How far behind the kerb of the block, or of the pavements on its other side.
    inner = np.minimum(np.minimum(x, WIDTH_M - x), np.minimum(y, HEIGHT_M - y)) - ROAD_M
    outer = np.maximum(np.maximum(-x, x - WIDTH_M), np.maximum(-y, y - HEIGHT_M)) - ROAD_M
    behind = np.maximum(inner, outer)
    assert np.all((behind > 0.95) & (behind < SIDEWALK_M - 0.35))
    for n in people:
        others = [m for m in people if m < n]
        assert np.all(np.linalg.norm(at[:, n, None, :2] - at[:, others, :2], axis=-1) > 0.55)


def test_feet_stand_on_the_pavement():
    world = loop(people=2, objects=0)
    feet = [mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, f"person {n} {side} foot")
            for n in (1, 2) for side in ("left", "right")]
    sole = np.array([0.05, 0.0, -0.08, 1.0])
    lowest = []
    for k in range(40):
        world.advance_to(k / 20.0)
        lowest.append((world.T_world_part[feet] @ sole)[:, 2].min())
    assert KERB_M - 0.02 < min(lowest) < KERB_M + 0.02
    assert max(lowest) < KERB_M + 0.06
