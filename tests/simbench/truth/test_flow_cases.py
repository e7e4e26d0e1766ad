"""Flow, fates and visible edges in cases with a plain answer."""

import mujoco
import numpy as np
import pytest

import ray_oracle as oracle
from simbench.truth import RayCaster, flow_between
from simbench.types import FrameTruth
from slam.geometry import se3


def test_a_frame_to_itself_does_not_move(marker_sequence):
    truth = marker_sequence.truth
    flow = flow_between(truth.frame(2), truth.frame(2), truth.layout, truth._caster)
    assert np.abs(flow.flow_px).max() < 1e-5
    assert not flow.scene_flow_m.any()
    for mask in (flow.occluded, flow.leaving, flow.newly_visible):
        assert not mask.any()


def test_points_behind_the_camera_leave_and_have_no_flow(marker_sequence):
    truth = marker_sequence.truth
    here = truth.frame(0)
    turned = se3.from_rotation_translation(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    away = FrameTruth(1, 0.1, here.T_world_camera @ turned, here.T_world_part,
                      np.zeros_like(here.depth_m), np.full_like(here.part_id, -1),
                      np.zeros_like(here.instance_id))
    flow = flow_between(here, away, truth.layout, truth._caster)
    assert not flow.valid.any()
    assert not flow.flow_px.any()
    assert np.array_equal(flow.leaving, here.part_id >= 0)


def test_a_caster_refuses_the_frames_of_another_scene(marker_sequence):
    truth = marker_sequence.truth
    other = RayCaster(mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="box" size="1 1 1"/></worldbody></mujoco>'))
    with pytest.raises(ValueError, match="1 parts, not"):
        flow_between(truth.frame(0), truth.frame(1), truth.layout, other)


def test_curved_geoms_hide_too(marker_sequence):
    """A sphere and a capsule, wherever their parts are put, against rays cast one by one."""
    model = mujoco.MjModel.from_xml_string("""
      <mujoco><worldbody>
        <geom type="box" size="5 .1 5" pos="0 4 0"/>
        <body><freejoint/><geom type="sphere" size=".4" pos=".1 0 0"/></body>
        <body><freejoint/><geom type="capsule" size=".2 .5" euler="20 30 0"/></body>
      </worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:] = [-0.5, 1.5, 0.2, 1, 0, 0, 0, 0.6, 2.0, 0.1, 0.9, 0.1, 0.3, 0.3]
    mujoco.mj_kinematics(model, data)
    T_world_part = se3.from_rotation_translation(data.xmat.reshape(-1, 3, 3), data.xpos)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    intrinsics = marker_sequence.intrinsics
    empty = np.zeros((intrinsics.height, intrinsics.width))
    frame = FrameTruth(0, 0.0, T_world_camera, T_world_part, empty, empty, empty)
    uv = oracle.pixels_of(frame, 7).astype(float)
    uvz = np.concatenate([uv, np.full((len(uv), 1), 3.5)], axis=1)
    rays = np.concatenate([(uv - [intrinsics.cx, intrinsics.cy]) / intrinsics.fx,
                           np.ones((len(uv), 1))], axis=1) @ T_world_camera[:3, :3].T
    expected = np.array([0 < mujoco.mj_ray(model, data, np.zeros(3), ray, None, 1, -1, None) < 3.5
                         for ray in rays])
    assert 0.05 < expected.mean() < 0.5
    assert np.array_equal(RayCaster(model).hides(frame, intrinsics)(uvz), expected)


def test_visible_edges_are_what_rays_reach(marker_sequence):
    """Points along every edge: inside a visible stretch a ray reaches them, outside none does."""
    truth, intrinsics = marker_sequence.truth, marker_sequence.intrinsics
    for k in (0, 4, 9):
        frame, visible, world = truth.frame(k), truth.edges(k), truth.world_at(k)
        edges = truth.layout.edges
        assert len(visible.edge) > 10
        ends = se3.transform_points(frame.T_world_part[edges.part_id], edges.endpoints_part)
        T_camera_world = se3.inverse(frame.T_world_camera)
        focal = np.array([intrinsics.fx, intrinsics.fy])
        centre = np.array([intrinsics.cx, intrinsics.cy])
        wrong = checked = 0
        for edge in range(len(ends)):
            t = np.linspace(0.0, 1.0, 41)[:, None]
            points = (1 - t) * ends[edge, 0] + t * ends[edge, 1]
            in_camera = se3.transform_points(T_camera_world, points)
            ahead = in_camera[:, 2] > 0.05
            uv = in_camera[:, :2] / np.where(ahead, in_camera[:, 2], 1.0)[:, None] * focal + centre
            shown = ahead & np.all((uv >= -0.5) & (uv < [intrinsics.width - 0.5,
                                                         intrinsics.height - 0.5]), axis=-1)
            distance, _ = oracle.cast(world, points - world.T_world_camera[:3, 3])
            range_m = np.linalg.norm(in_camera, axis=-1)
            reached = shown & (distance * range_m > range_m - 2e-3)
            stretches = visible.endpoints_px[visible.edge == edge]
            covered = np.zeros(len(t), bool)
            unsure = np.zeros(len(t), bool)
            for start, stop in stretches:
                along = (stop - start) / np.linalg.norm(stop - start)
                s = (uv - start) @ along
                length = np.linalg.norm(stop - start)
                covered |= shown & (s >= 0) & (s <= length)
                unsure |= (np.abs(s) < 2.5) | (np.abs(s - length) < 2.5)
            sure = ~unsure
            # A stretch of less than 5 px is left out on purpose.
            run = reached & ~covered & sure
            step_px = np.linalg.norm(np.diff(uv, axis=0), axis=-1).max()
            sure &= ~(run & (run.sum() * step_px < 8.0))
            checked += sure.sum()
            wrong += (covered != reached)[sure].sum()
        assert wrong <= 0.01 * checked
        rays = visible.endpoints_camera / visible.endpoints_camera[..., 2:]
        assert np.allclose(rays[..., :2] * focal + centre, visible.endpoints_px, atol=1e-9)
        assert np.array_equal(visible.instance_id,
                              truth.layout.instance_of_part[edges.part_id[visible.edge]])
