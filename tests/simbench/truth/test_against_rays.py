"""Depth, parts, flow and visibility against rays cast one by one."""

import numpy as np
import pytest

import ray_oracle as oracle
from simbench.render import make_renderer
from simbench.scene import list_scenes
from simbench.simulate import SimulatedSequence
from simbench.world import make_world

PAIRS = [(3, 4), (1, 9), (9, 2)]   # neighbours, far apart, backward
SCENES = ["MarkerRoom-v0", *(spec.name for spec in list_scenes())]


@pytest.fixture(scope="module", params=SCENES)
def scene(request, marker_spec):
    """A sequence, and the stride at which its pixels are checked."""
    small = request.param == "MarkerRoom-v0"
    world = make_world(marker_spec if small else request.param)
    renderer = make_renderer("mujoco", world)
    yield SimulatedSequence(world, renderer, 10), 2 if small else 8
    renderer.close()


@pytest.fixture(scope="module", params=PAIRS, ids=str)
def case(request, scene):
    sequence, stride = scene
    i, j = request.param
    truth = sequence.truth
    return (truth.frame(i), truth.frame(j), truth.flow(i, j), oracle.land(truth, i, j, stride),
            stride)


def test_depth_and_parts_are_those_that_rays_hit(case):
    frame, _, _, landing, stride = case
    part = oracle.on_grid(frame.part_id, stride)
    depth = oracle.on_grid(frame.depth_m, stride).astype(np.float64)
    differs = part != landing.part
    assert differs.mean() <= 1e-3
    assert oracle.on_grid(oracle.near_part_borders(frame.part_id), stride)[differs].all()
    assert np.all(depth[part < 0] == 0.0)
    seen = ~differs & (part >= 0)
    true = landing.depth_m[seen]
    wrong = np.abs(depth[seen] - true) > 1e-4 * np.where(true > 10.0, true, 1.0)
    assert wrong.mean() <= 1e-3
    assert oracle.on_grid(oracle.near_steps(frame.depth_m), stride)[seen][wrong].all()


def test_flow_is_analytic_away_from_steps(case):
    frame, _, flow, landing, stride = case
    clear = landing.inside & ~oracle.on_grid(oracle.near_steps(frame.depth_m), stride)
    error = np.linalg.norm(oracle.on_grid(flow.flow_px, stride) - landing.flow_px, axis=-1)[clear]
    assert clear.mean() > 0.2
    planar = ~oracle.on_grid(oracle.near_bends(frame.depth_m), stride)[clear]
    assert planar.mean() > 0.5
    assert error[planar].max() < 1e-3
    assert np.quantile(error, 0.999) < 1e-3
    assert np.median(error) < 1e-4
    moved = np.abs(oracle.on_grid(flow.scene_flow_m, stride) - landing.scene_flow_m)[clear]
    assert moved.max() < 2e-4


def test_fates_agree_with_rays(case):
    frame_i, frame_j, flow, landing, stride = case
    hit = landing.part >= 0
    same_part = hit & (oracle.on_grid(frame_i.part_id, stride) == landing.part)
    border = oracle.on_grid(oracle.near_bends(frame_i.depth_m), stride)
    height, width = frame_j.depth_m.shape
    u, v = np.rint(oracle.pixels_of(frame_i, stride) + landing.flow_px).astype(int).T
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    border |= oracle.near_bends(frame_j.depth_m)[v, u]
    border |= (u == 0) | (v == 0) | (u == width - 1) | (v == height - 1)
    for name, expected in (("occluded", landing.hidden), ("leaving", hit & ~landing.inside),
                           ("valid", landing.ahead)):
        wrong = (oracle.on_grid(getattr(flow, name), stride) != expected) & same_part
        assert wrong.mean() <= 1e-3, name
        assert border[wrong].all(), name


def test_newly_visible_is_what_rays_from_the_other_camera_do_not_meet(scene):
    sequence, stride = scene
    i, j = 1, 7
    back = oracle.land(sequence.truth, j, i, stride)
    expected = (back.part >= 0) & ~(back.inside & ~back.hidden)
    got = oracle.on_grid(sequence.truth.flow(i, j).newly_visible, stride)
    assert expected.any()
    assert (got != expected).mean() <= 1e-3


def test_every_surface_has_one_fate(case):
    frame, _, flow, _, _ = case
    surface = frame.part_id >= 0
    visible = flow.valid & ~flow.occluded & ~flow.leaving
    assert np.array_equal(visible.astype(int) + flow.occluded + flow.leaving, surface.astype(int))
    assert not (flow.flow_px[~flow.valid]).any()
    assert np.isfinite(flow.flow_px).all()
