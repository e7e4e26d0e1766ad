"""Office-v0: people who walk without sliding, fill the picture as they are to, and stay apart."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from simbench.errors import UnknownName, UserError
from simbench.render import make_renderer
from simbench.scene import find_scene
from simbench.scenes_builtin.office import CAMERA_MOTIONS, PEOPLE
from simbench.world import make_world
from slam.geometry import se3

SMALL = (80, 60)


def office(seed=0, **dials):
    return make_world("Office-v0", seed, dials, SMALL)


def body(world, name):
    return mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, name)


@pytest.mark.parametrize("motion", CAMERA_MOTIONS)
def test_people_cover_a_fifth_to_a_half_of_most_pictures(motion):
    world = office(seed=1, camera_motion=motion)
    renderer = make_renderer("mujoco", world)
    of_person = np.array([0, *(each.name.startswith("person") for each in world.layout.objects)])
    cover = []
    for time_s in np.arange(0.0, 10.0, 0.25):
        world.advance_to(float(time_s))
        _, part = renderer.depth_and_parts(world)
        cover.append(of_person[np.append(world.layout.instance_of_part, 0)[part]].mean())
    renderer.close()
    assert np.mean([0.2 <= each <= 0.5 for each in cover]) >= 0.5
    assert max(cover) < 0.6


def test_a_foot_that_carries_stands_still():
    world = office()
    names = [f"person {n} {side} foot" for n in (1, 2, 3) for side in ("left", "right")]
    feet = [body(world, name) for name in names]
    pelvis = [body(world, f"person {n}") for n in (1, 1, 2, 2, 3, 3)]
    ball = np.array([0.11, 0.0, -0.08, 1.0])
    at, carried = [], []
    for k in range(90):
        world.advance_to(k / 30.0)
        at.append((world.T_world_part[feet] @ ball)[:, :3])
        carried.append(world.T_world_part[pelvis][:, :2, 3])
    at, carried = np.array(at), np.array(carried)
    assert at[..., 2].min() > -0.012
    speed, walk = (np.linalg.norm(np.diff(each[..., :2], axis=0), axis=-1) * 30.0
                   for each in (at, carried))
    assert walk.mean() > 0.7
    # Of the two feet of a person one stands at any time.
    slower = np.minimum(speed[:, 0::2], speed[:, 1::2])
    assert np.median(slower) < 0.08 * walk.mean()
    assert np.quantile(slower, 0.9) < 0.25 * walk.mean()


def test_limbs_swing_against_each_other():
    world = office()
    names = ("left hip", "right hip", "left shoulder", "left knee")
    joints = [mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_JOINT, f"person 1 {name}")
              for name in names]
    angles = []
    for k in range(60):
        world.advance_to(k / 20.0)
        angles.append(world.data.qpos[world.model.jnt_qposadr[joints]])
    angle = dict(zip(names, np.transpose(angles), strict=True))
    assert all(np.ptp(each) > np.deg2rad(25.0) for each in angle.values())
    assert np.corrcoef(angle["left hip"], angle["right hip"])[0, 1] < -0.5
    assert np.corrcoef(angle["left hip"], angle["left shoulder"])[0, 1] < -0.5
    assert min(angle["left knee"]) >= 0.0      # knees bend one way


@pytest.mark.parametrize("seed", range(3))
def test_people_keep_apart_and_the_camera_in_the_room(seed):
    world = office(seed, undetected=1.0)
    roots = [body(world, name) for name in ("person 1", "person 2", "person 3", "kicked box")]
    for time_s in np.arange(0.0, 10.0, 0.1):
        world.advance_to(float(time_s))
        at = world.T_world_part[roots][:, :2, 3]
        gaps = [np.linalg.norm(a - b) for a, b in itertools.combinations(at, 2)]
        assert min(gaps) > 0.43
        assert np.all(np.abs(world.T_world_camera[:3, 3] - [0, 0, 1.35]) < [3.1, 2.7, 1.25])
        assert np.linalg.norm(at - world.T_world_camera[:2, 3], axis=1).min() > 0.7


def test_who_is_an_object_and_who_is_rigid():
    def rigid(**dials):
        return {o.name: o.rigid for o in office(**dials).layout.objects}

    assert rigid() == {"person 1": False, "person 2": False, "person 3": False, "chair 1": True}
    assert rigid(people="sitting") == {"person 1": False, "person 2": False}
    assert rigid(people="none", undetected=1) == {}
    assert rigid(people="visit") == {"person 1": False}


def test_the_visitor_comes_turns_a_chair_without_a_mask_and_goes():
    world = office(people="visit", camera_motion="static")
    chair, visitor = body(world, "turned chair"), body(world, "person 1")
    assert world.layout.instance_of_part[chair] == 0
    poses = []
    for time_s in (0.0, 3.5, 5.2, 7.0, 10.0):
        world.advance_to(time_s)
        poses.append(world.T_world_part[[chair, visitor]])
    turned = se3.rotation_angle(poses[0][0, :3, :3].T @ np.stack(poses)[:, 0, :3, :3])
    assert turned[1] < 1e-9
    assert 0.2 < turned[2] < turned[3]
    assert abs(turned[3] - turned[4]) < 1e-9
    assert turned[3] > 1.2
    beside = [np.linalg.norm(each[1, :2, 3] - each[0, :2, 3]) for each in poses]
    assert beside[2] < 1.05 < min(beside[0], beside[4])
    assert poses[0][1, 1, 3] > 2.2        # behind the door's wall, where nobody sees them


def test_choices_go_by_name_or_number():
    spec = find_scene("Office-v0")
    assert spec.resolve_dials({"people": "sitting"}) == spec.resolve_dials({"people": 1})
    assert [dial.shown(dial.default) for dial in spec.dials[:2]] == ["walking", "xyz"]
    assert spec.dials[0].allowed == ", ".join(PEOPLE)
    with pytest.raises(UnknownName, match="people=running must be one of walking, sitting"):
        spec.resolve_dials({"people": "running"})
    with pytest.raises(UserError, match="speed=fast must be a number from 0 to 2"):
        spec.resolve_dials({"speed": "fast"})


@pytest.mark.parametrize("people", PEOPLE)
def test_detectors_know_people_and_chairs_with_masks(people):
    for each in office(people=people).layout.objects:
        assert each.category == each.name.split()[0]
