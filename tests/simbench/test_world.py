"""The moving world: equal seeds, going back, and the camera."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from simbench.motion import look_at
from simbench.world import make_world
from slam.geometry import se3

SCENES = ("SwingingBoxes-v0", "Street-v0")
SMALL = (64, 48)


@pytest.fixture(scope="module", params=SCENES)
def world(request):
    return make_world(request.param, seed=1, dials={"rigidity": 0.5}, size=SMALL)


def snapshot(world):
    return (world.state().tobytes(), world.T_world_part.tobytes(), world.T_world_camera.tobytes(),
            world.data.geom_xpos.tobytes(), world.data.light_xpos.tobytes(),
            world.data.cam_xpos.tobytes())


def test_equal_seeds_give_equal_worlds_and_others_differ(world):
    dials = {"rigidity": 0.5}
    first, second, other = world, *(make_world(world.spec, seed, dials, SMALL) for seed in (1, 2))
    for each in (first, second, other):
        each.reset()
        each.advance_to(0.37)
    assert snapshot(first) == snapshot(second)
    assert_array_equal(first.model.mat_rgba, second.model.mat_rgba)
    assert_array_equal(first.model.mesh_vert, second.model.mesh_vert)
    assert not np.array_equal(first.model.mat_rgba, other.model.mat_rgba)
    assert not np.allclose(first.T_world_camera, other.T_world_camera)


def test_reset_gives_equal_bytes(world):
    world.reset()
    start = snapshot(world)
    world.advance_to(0.9)
    assert snapshot(world) != start
    world.reset()
    assert snapshot(world) == start


def test_restore_goes_back_exactly_and_on_again(world):
    world.reset()
    world.advance_to(0.512)   # between two physics steps
    state, here = world.state(), snapshot(world)
    world.advance_to(1.3)
    there = snapshot(world)
    world.restore(state)
    assert snapshot(world) == here
    world.advance_to(1.3)
    assert snapshot(world) == there


def test_the_way_to_a_time_does_not_matter(world):
    world.reset()
    world.advance_to(0.8)
    direct = snapshot(world)
    world.reset()
    for time_s in (0.1, 0.1, 0.2503, 0.61, 0.8):
        world.advance_to(time_s)
    assert snapshot(world) == direct


def test_time_runs_forward_only(world):
    world.reset()
    world.advance_to(0.5)
    with pytest.raises(ValueError, match=r"0\.5"):
        world.advance_to(0.4)
    with pytest.raises(ValueError, match="no state"):
        world.restore(np.zeros(3))


def test_camera_offset_is_added_in_the_cameras_frame(world):
    world.reset()
    scripted = world.T_world_camera
    offset = se3.exp(np.array([0.1, -0.05, 0.2, 0.3, -0.1, 0.2]))
    world.camera_offset = offset
    assert_allclose(world.T_world_camera, scripted @ offset, atol=1e-12)
    state = world.state()
    world.reset()
    assert_array_equal(world.T_world_camera, scripted)
    world.restore(state)
    assert_allclose(world.T_world_camera, scripted @ offset, atol=1e-12)


def test_the_mujoco_camera_is_the_opencv_camera(world):
    world.reset()
    world.advance_to(0.4)
    camera = mujoco.mj_name2id(world.model, mujoco.mjtObj.mjOBJ_CAMERA, "camera")
    R = world.data.cam_xmat[camera].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
    assert_allclose(world.T_world_camera[:3, :3], R, atol=1e-12)
    assert_allclose(world.T_world_camera[:3, 3], world.data.cam_xpos[camera], atol=1e-12)


def test_part_poses_are_rigid_and_those_of_mujoco(world):
    world.reset()
    world.advance_to(0.4)
    T = world.T_world_part
    assert_allclose(T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2),
                    np.broadcast_to(np.eye(3), (len(T), 3, 3)), atol=1e-14)
    assert_allclose(T[:, :3, :3], world.data.xmat.reshape(-1, 3, 3), atol=1e-12)
    assert_allclose(T[:, :3, 3], world.data.xpos, atol=0.0)


def test_physics_steps_divide_a_frame_for_motion_blur():
    for fps in (10.0, 30.0, 60.0):
        world = make_world("SwingingBoxes-v0", 0, size=SMALL, fps=fps)
        steps = 1.0 / (fps * world.model.opt.timestep)
        assert_allclose(steps / 16.0, max(1, round(steps / 16.0)), rtol=1e-12)
        assert world.model.opt.timestep < 0.0022


def test_looking_at_a_point_puts_it_in_the_middle_and_up_is_up():
    T = look_at((1.0, 2.0, 3.0), (4.0, -1.0, 2.0))
    target = se3.transform_points(se3.inverse(T), np.array([[4.0, -1.0, 2.0], [4.0, -1.0, 2.5]]))
    assert_allclose(target[0, :2], 0.0, atol=1e-12)
    assert target[0, 2] > 0.0
    assert target[1, 1] < 0.0   # higher in the world is up in the image: smaller v
