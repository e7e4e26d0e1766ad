"""Street-v0's variety: what stands beside the road, where it goes, who rides, who stops."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from simbench.scenes_builtin.pace import StopAndGo, kept_between
from simbench.world import make_world
from slam.geometry import se3

SMALL = (76, 24)


def street(seed=0, **dials):
    return make_world("Street-v0", seed, dials, SMALL)


def test_cyclists_ride_between_driving_and_parked_cars_and_pedal():
    world = street(1, cyclists=3, route="straight")
    objects = {each.name: each for each in world.layout.objects}
    riders = [objects[f"cyclist {n}"].root_part for n in (1, 2, 3)]
    cars = [each.root_part for name, each in objects.items() if "car" in name]
    knees = [world.model.joint(f"cyclist 1 rider {side} knee").qposadr[0]
             for side in ("left", "right")]
    overtaken, bent = [], []
    for k in range(100):
        world.advance_to(k / 10.0)
        at = world.T_world_part[riders][:, :3, 3]
        assert np.allclose(np.abs(at[:, 1]), 3.14, atol=0.06)
        in_car = np.einsum("cij,rj->cri", se3.inverse(world.T_world_part[cars]),
                           np.c_[at, np.ones(3)])
        assert np.all((np.abs(in_car[..., 0]) > 3.3) | (np.abs(in_car[..., 1]) > 1.25))
        overtaken.append((se3.inverse(world.T_world_camera) @ [*at[0], 1.0])[2])
        bent.append(world.data.qpos[knees])
    assert overtaken[0] > 5.0
    assert overtaken[-1] < 0.0
    bent = np.array(bent)
    assert np.all(np.ptp(bent, axis=0) > np.deg2rad(40.0))
    assert bent.min() > 0.0
    assert np.corrcoef(bent.T)[0, 1] < -0.5


@pytest.mark.parametrize("limbs", [0.0, 0.5])
def test_feet_stay_on_the_pedals(limbs):
    world = street(0, cyclists=1, objects=0, limbs=limbs)
    names = ("cyclist 1", "cyclist 1 crank", "cyclist 1 rider left foot", "cyclist 1 front wheel")
    bike, crank, foot, wheel = (mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, name)
                                for name in names)
    pedal = np.array([limbs * 0.17, 0.11, 0.0, 1.0])
    apart, moved = [], []
    for k in range(30):
        world.advance_to(k / 10.0)
        T = world.T_world_part
        apart.append((se3.inverse(T[bike]) @ (T[foot][:, 3] - T[crank] @ pedal))[:3])
        moved.append(se3.inverse(T[bike]) @ T[[foot, wheel]])
    assert np.ptp(apart, axis=0).max() < 0.015
    moved = np.stack(moved)
    if limbs == 0.0:
        assert np.abs(moved - moved[0]).max() < 1e-9
        assert world.layout.objects[-1].rigid
    else:
        assert np.ptp(moved[:, 0, :3, 3], axis=0).max() > 0.1
        assert not world.layout.objects[-1].rigid


def test_stopped_traffic_stands_for_some_seconds_and_goes_on():
    world = street(2, traffic="stopped", surroundings="open")
    roots = [world.layout.objects[0].root_part]
    at = []
    for k in range(100):
        world.advance_to(k / 10.0)
        at.append([world.T_world_camera[:2, 3], *world.T_world_part[roots][:, :2, 3]])
    speed = np.linalg.norm(np.diff(at, axis=0), axis=-1) * 10.0
    assert np.all(((speed < 0.3).sum(axis=0) >= 20) & ((speed < 0.3).sum(axis=0) < 50))
    assert np.all(speed[:10].mean(axis=0) > 3.0)
    assert np.all(speed[-5:].mean(axis=0) > 1.0)
    assert np.abs(np.diff(speed[:, 0])).max() < 0.6     # 6 m/s²


def test_the_straight_route_does_not_turn_and_fields_have_no_houses():
    world = street(3, route="straight", surroundings="open", cyclists=0)
    first = world.T_world_camera[:3, 2]
    world.advance_to(9.9)
    assert first @ world.T_world_camera[:3, 2] > 0.999
    meshes = {world.model.geom(g).matid[0] for g in range(world.model.ngeom)}
    seen = {world.model.material(int(m)).name for m in meshes}
    assert not any(name.startswith(("facade", "pane")) for name in seen)
    assert "leaves" in seen


def test_clocks_never_run_backwards():
    clock = StopAndGo(12.0, 1.3)
    times = np.array([clock(t) for t in np.arange(0.0, 40.0, 0.05)])
    assert times[0] == 0.0
    assert np.all(np.diff(times) >= 0.0)
    assert np.diff(times).max() <= 0.05 * 1.001
    gaps = [kept_between(g, 2.0, 9.0) for g in np.linspace(-50.0, 50.0, 400)]
    assert np.all(np.diff(gaps) >= 0.0)
    assert 2.0 <= min(gaps) < 2.1
    assert 8.9 < max(gaps) <= 9.0
