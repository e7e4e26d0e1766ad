"""What the built-in scenes promise: who is seen, who moves how, and what the dials do."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from simbench.render import make_renderer
from simbench.scene import list_scenes
from simbench.world import make_world
from slam.geometry import se3

SMALL = (64, 48)
BUILT_IN = ("SwingingBoxes-v0", "Street-v0")
ALL = ("SwingingBoxes-v0", "Street-v0", "Office-v0", "Corridor-v0", "Loop-v0")
BUSY = {"Street-v0": {"cyclists": 3, "surroundings": "trees"}, "Corridor-v0": {"texture": 1.0},
        "Loop-v0": {"people": 2, "objects": 1}}


@lru_cache
def small_world(scene, seed=0, **dials):
    """A world shared by the tests that change nothing but its time; see `fresh`."""
    return make_world(scene, seed, dials, SMALL)


def fresh(scene, seed=0, **dials):
    world = small_world(scene, seed, **dials)
    world.reset()
    return world


def object_poses(world, frames, fps):
    """(K, O, 4, 4) poses of all objects and (K, 4, 4) of the camera."""
    roots = [each.root_part for each in world.layout.objects]
    poses, cameras = [], []
    for k in range(frames):
        world.advance_to(k / fps)
        poses.append(world.T_world_part[roots])
        cameras.append(world.T_world_camera)
    return np.stack(poses), np.stack(cameras)


def half_sizes(world):
    """(O, 3) half sizes and (O, 3) centres of the objects' bounding boxes, in their own frames."""
    model, halves, centres = world.model, [], []
    for each in world.layout.objects:
        points = []
        for geom in np.flatnonzero(model.geom_bodyid == each.root_part):
            if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                mesh = model.geom_dataid[geom]
                first = model.mesh_vertadr[mesh]
                vertices = model.mesh_vert[first:first + model.mesh_vertnum[mesh]]
                R = se3.rotation_from_quaternion(np.roll(model.geom_quat[geom], -1))
                points.append(vertices @ R.T + model.geom_pos[geom])
        points = np.concatenate(points)
        halves.append(np.ptp(points, axis=0) / 2.0)
        centres.append((points.max(0) + points.min(0)) / 2.0)
    return np.stack(halves), np.stack(centres)


def overlap(T_a, half_a, T_b, half_b):
    """(K,) do two boxes with poses (K, 4, 4) overlap? By separating axes."""
    Ra, Rb = T_a[:, :3, :3], T_b[:, :3, :3]
    cross = np.cross(Ra[:, :, :, None], Rb[:, :, None, :], axis=1).reshape(len(T_a), 3, 9)
    axes = np.concatenate([Ra, Rb, cross], axis=2)
    reach = sum(np.einsum("kij,i->kj", np.abs(np.swapaxes(R, 1, 2) @ axes), half)
                for R, half in ((Ra, half_a), (Rb, half_b)))
    gap = np.abs(np.einsum("kij,ki->kj", axes, T_b[:, :3, 3] - T_a[:, :3, 3]))
    return np.all(gap <= reach + 1e-12, axis=1)


def assert_apart(world, poses, margin=0.0):
    halves, centres = half_sizes(world)
    T = poses.copy()
    T[..., :3, 3] = poses[..., :3, 3] + (poses[..., :3, :3] @ centres[:, :, None])[..., 0]
    for a in range(len(halves)):
        for b in range(a):
            assert not overlap(T[:, a], halves[a] + margin, T[:, b], halves[b]).any(), (a, b)


@pytest.mark.parametrize("seed", range(5))
def test_boxes_swing_in_view_without_touching(seed):
    world = make_world("SwingingBoxes-v0", seed)
    poses, cameras = object_poses(world, 300, 30.0)
    assert len(world.layout.objects) == 4
    assert_apart(world, poses)
    # The camera stays in the room and the boxes in its picture, at the distances of the original.
    assert np.all(np.abs(cameras[:, :3, 3] - [0.0, 0.0, 1.4]) < [3.3, 2.5, 1.0])
    i = world.layout.intrinsics
    centre = np.einsum("kij,koj->koi", se3.inverse(cameras), poses[..., :, 3])
    u, v = (i.fx * centre[..., 0] / centre[..., 2], i.fy * centre[..., 1] / centre[..., 2])
    inside = (np.abs(u) < i.width / 2) & (np.abs(v) < i.height / 2)
    assert np.all(inside.mean(axis=0) > 0.95)
    assert np.all((centre[..., 2] > 1.4) & (centre[..., 2] < 4.6))
    # Both camera and boxes move as hands and pendulums do.
    increments = se3.log(se3.inverse(cameras[:-1]) @ cameras[1:]) * 30.0
    speed, rate = (np.linalg.norm(increments[:, s], axis=1) for s in (slice(3, 6), slice(3)))
    assert 0.1 < speed.mean() < 0.7
    assert 5.0 < np.rad2deg(rate.mean()) < 40.0
    box_speed = np.linalg.norm(np.diff(poses[..., :3, 3], axis=0), axis=-1).mean(axis=0) * 30.0
    assert np.all((box_speed > 0.1) & (box_speed < 1.5))


def test_twenty_boxes_do_not_touch_either():
    world = make_world("SwingingBoxes-v0", 0, {"objects": 20}, SMALL)
    assert len(world.layout.objects) == 20
    assert_apart(world, object_poses(world, 150, 15.0)[0])


def test_a_pendulum_keeps_its_energy():
    world = make_world("SwingingBoxes-v0", 2, size=SMALL)
    world.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    energy = []
    for time_s in (0.0, 3.0, 10.0):
        world.advance_to(time_s)
        mujoco.mj_forward(world.model, world.data)
        energy.append(world.data.energy.sum())
    swing = 0.5   # J, the order of what goes to and fro
    assert_allclose(energy, energy[0], atol=1e-3 * swing)


@pytest.mark.parametrize("dials", [{}, {"speed": 2.0, "objects": 12},
                                   {"speed": 0.0, "camera_speed": 1.5}])
def test_cars_never_touch_each_other_or_the_camera(dials):
    world = fresh("Street-v0", 1, **dials)
    poses, cameras = object_poses(world, 100, 10.0)
    assert_apart(world, poses)
    assert np.linalg.norm(poses[..., :2, 3] - cameras[:, None, :2, 3], axis=-1).min() > 2.2


@pytest.mark.parametrize("seed", range(2))
def test_street_has_cars_ahead_oncoming_turning_and_parked(seed):
    world = fresh("Street-v0", seed)
    poses, cameras = object_poses(world, 100, 10.0)
    names = [each.name for each in world.layout.objects]
    parked = np.array([name.startswith("parked") for name in names])
    assert parked.sum() >= 10
    assert_array_equal(poses[0][parked], poses[-1][parked])
    driving = poses[:, ~parked]
    step = np.linalg.norm(np.diff(driving[..., :3, 3], axis=0), axis=-1)
    assert np.all(step.mean(axis=0) > 0.3)
    in_camera = np.einsum("kij,koj->koi", se3.inverse(cameras), driving[..., :, 3])
    near = (in_camera[..., 2] > 5.0) & (in_camera[..., 2] < 30.0) \
        & (np.abs(in_camera[..., 0]) < 0.8 * in_camera[..., 2])
    assert np.all(near.any(axis=1))        # always one to be measured
    heading = driving[..., :3, 0]
    against = np.einsum("koi,ki->ko", heading, cameras[:, :3, 2])
    assert np.any((against < -0.9) & near)                       # oncoming
    turned = np.einsum("koi,oi->ko", heading, heading[0])
    assert np.any((turned[1:] < 0.5) & (turned[:-1] > 0.5) & near[1:])   # turning
    speed = np.linalg.norm(np.diff(cameras[:, :3, 3], axis=0), axis=-1) * 10.0
    assert speed.min() > 5.0
    assert speed.max() < 12.0


def test_wheels_roll_without_slipping_where_the_road_is_straight():
    world = fresh("Street-v0")
    car = next(each for each in world.layout.objects if each.name == "car 1")
    wheel = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_BODY, "car 1 wheel 0")
    radius = world.model.body_pos[wheel][2]
    ground = np.array([0.0, 0.0, -radius, 1.0])
    world.advance_to(0.4)
    before = world.T_world_part
    touching = se3.inverse(before[wheel]) @ before[car.root_part] \
        @ (np.append(world.model.body_pos[wheel], 0.0) + ground)
    world.advance_to(0.4 + 1e-4)
    after = world.T_world_part
    travelled = np.linalg.norm((after - before)[car.root_part, :3, 3])
    slip = np.linalg.norm(((after[wheel] - before[wheel]) @ touching)[:3])
    assert travelled > 4e-4
    assert slip < 0.02 * travelled


@pytest.mark.parametrize("scene", ALL)
def test_only_what_pixels_and_rays_see_alike_is_in_the_scenes(scene):
    model = fresh(scene, **BUSY.get(scene, {})).model
    solid = [int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_MESH)]
    assert np.all(np.isin(model.geom_type, solid))
    assert np.all(model.geom_group <= 2)
    assert np.all(model.mat_rgba[:, 3] == 1.0)
    assert np.all(model.mat_reflectance == 0.0)
    assert not model.geom_contype.any()


@pytest.mark.parametrize("scene", BUILT_IN)
def test_rigidity_makes_parts_of_objects_move(scene):
    rigid, flapping = fresh(scene), fresh(scene, rigidity=0.5)
    moving = [o for o in rigid.layout.objects if not o.name.startswith("parked")]
    assert all(o.rigid for o in rigid.layout.objects)
    assert not any(o.rigid for o in flapping.layout.objects[:len(moving)])
    model = flapping.model
    for name in ("front flap", "left door"):
        parts = [b for b in range(model.nbody) if model.body(b).name.endswith(name)]
        for part in parts:
            parent = model.body_parentid[part]
            relative = []
            flapping.reset()
            for time_s in (0.0, 0.4, 0.8):
                flapping.advance_to(time_s)
                T = flapping.T_world_part
                relative.append(se3.inverse(T[parent]) @ T[part])
            turned = se3.rotation_angle(relative[0][:3, :3].T @ np.stack(relative)[1:, :3, :3])
            assert turned.max() > np.deg2rad(1.0)
    # The pendulum, or the way of the car, is the same.
    rigid.advance_to(0.8)
    roots = [(a.root_part, b.root_part) for a, b in
             zip(rigid.layout.objects, flapping.layout.objects, strict=True)]
    for a, b in roots:
        assert_allclose(rigid.T_world_part[a], flapping.T_world_part[b], atol=2e-4)


def test_speed_and_camera_speed_are_factors_of_time():
    slow, fast, still = (make_world("SwingingBoxes-v0", 1, {"speed": s, "camera_speed": s}, SMALL)
                         for s in (1.0, 2.0, 0.0))
    slow.advance_to(1.0)
    fast.advance_to(0.5)
    assert_allclose(fast.T_world_camera, slow.T_world_camera, atol=1e-12)
    assert_allclose(fast.T_world_part, slow.T_world_part, atol=1e-5)
    start = still.T_world_part
    still.advance_to(2.0)
    assert_allclose(still.T_world_part, start, atol=1e-12)


@pytest.mark.parametrize("scene", ALL)
def test_texture_and_light(scene):
    busy = BUSY.get(scene, {})
    full, plain = (each.model for each in (
        fresh(scene, **busy), make_world(scene, 0, {**busy, "texture": 0.0, "light": 0.5}, SMALL)))
    for texture in range(full.ntex):
        if full.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D:
            start, channels = full.tex_adr[texture], full.tex_nchannel[texture]
            stop = start + full.tex_width[texture] * full.tex_height[texture] * channels
            before, after = (m.tex_data[start:stop].reshape(-1, channels) for m in (full, plain))
            assert np.ptp(after, axis=0).max() == 0
            assert np.ptp(before, axis=0).min() > 60
            assert_allclose(after[0], before.mean(axis=0), atol=0.51)
    assert_allclose(plain.light_diffuse, 0.5 * full.light_diffuse)
    assert_allclose(plain.vis.headlight.ambient, 0.5 * np.asarray(full.vis.headlight.ambient))


@pytest.mark.parametrize("scene", BUILT_IN)
def test_corners_of_objects_land_on_their_own_masks(scene):
    """Through the documented intrinsics and poses alone."""
    world = make_world(scene, 0)
    renderer = make_renderer("mujoco", world)
    halves, centres = half_sizes(world)
    i, signs = world.layout.intrinsics, np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
    seen = 0
    for time_s in (0.0, 1.7, 3.1):
        world.advance_to(time_s)
        depth, part = renderer.depth_and_parts(world)
        T_camera_world = se3.inverse(world.T_world_camera)
        for number, each in enumerate(world.layout.objects):
            # A touch inside the corners for a box; at bumper height, front and rear, for a car.
            if scene == BUILT_IN[0]:
                local = 0.96 * signs * halves[number]
            else:
                local = halves[number] * [[0.8, 0.0, -0.4], [-0.8, 0.0, -0.4], [0.0, 0.6, -0.4],
                                          [0.0, -0.6, -0.4]]
            p = se3.transform_points(T_camera_world @ world.T_world_part[each.root_part],
                                     local + centres[number])
            front = p[:, 2] > 0.5
            u = np.rint(i.fx * p[front, 0] / p[front, 2] + i.cx).astype(int)
            v = np.rint(i.fy * p[front, 1] / p[front, 2] + i.cy).astype(int)
            inside = (u >= 0) & (u < i.width) & (v >= 0) & (v < i.height)
            u, v, z = u[inside], v[inside], p[front, 2][inside]
            # The point is inside the object: only something nearer may hide it.
            own = world.layout.instance_of_part[part[v, u]] == each.instance_id
            hidden = ~own & (depth[v, u] < z) & (part[v, u] >= 0)
            assert np.all(own | hidden), (each.name, time_s)
            seen += int(own.sum())
    renderer.close()
    assert seen > 20


@pytest.mark.parametrize("scene", BUILT_IN)
def test_edges_lie_on_visible_things(scene):
    layout = fresh(scene).layout
    length = np.linalg.norm(layout.edges.endpoints_part[:, 1] - layout.edges.endpoints_part[:, 0],
                            axis=1)
    assert length.min() >= (0.1 if scene == BUILT_IN[0] else 0.25)
    of_object = np.bincount(layout.instance_of_part[layout.edges.part_id])
    assert len(of_object) == len(layout.objects) + 1
    assert of_object[0] > 500
    if scene == BUILT_IN[0]:
        assert_array_equal(of_object[1:], 12)   # the strings are too thin
    else:
        assert np.all(of_object[1:] > 20)


def test_every_scene_says_what_it_is():
    for spec in list_scenes():
        assert spec.description
        assert {"texture", "light"} <= {dial.name for dial in spec.dials}
        for dial in spec.dials:
            assert dial.low <= dial.default <= dial.high
            assert dial.help
