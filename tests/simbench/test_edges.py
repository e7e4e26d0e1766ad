"""Edges of boxes and meshes, where MuJoCo puts them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.testing import assert_allclose

from simbench.edges import model_edges
from simbench.meshes import MeshBuilder, visible_geom


def lengths(edges):
    return np.linalg.norm(edges.endpoints_part[:, 1] - edges.endpoints_part[:, 0], axis=1)


def compiled(*builders: MeshBuilder, quat=(1.0, 0.0, 0.0, 0.0)):
    spec = mujoco.MjSpec()
    spec.add_material(name="plain")
    body = spec.worldbody.add_body(name="thing", pos=[1.0, 2.0, 3.0], quat=quat)
    for number, builder in enumerate(builders):
        builder.add_to(spec, f"mesh {number}")
        visible_geom(body, f"mesh {number}", "plain")
    return spec.compile()


def as_set(endpoints):
    return {tuple(sorted(map(tuple, np.round(pair, 4) + 0.0))) for pair in endpoints}


BOX = """<mujoco><worldbody>
  <geom type="plane" size="9 9 1"/>
  <body pos="0 0 5"><geom type="box" size=".5 .3 .2" pos="1 0 0" euler="0 0 90"/></body>
  <geom type="box" size="1 .002 .002" pos="0 0 1"/>
  <geom type="sphere" size="1" pos="0 0 9"/>
</worldbody></mujoco>"""


def test_a_box_has_twelve_edges_and_planes_spheres_and_rods_have_none():
    edges = model_edges(mujoco.MjModel.from_xml_string(BOX))
    assert edges.part_id.tolist() == [1] * 12
    assert_allclose(np.sort(lengths(edges)), np.repeat([0.4, 0.6, 1.0], 4), atol=1e-12)
    assert_allclose(edges.endpoints_part.reshape(-1, 3).min(0), [0.7, -0.5, -0.2], atol=1e-12)


def test_a_finely_split_mesh_box_has_the_same_twelve_edges_wherever_mujoco_centres_it():
    builder = MeshBuilder()
    builder.box((0.4, -0.2, 0.9), (2.0, 1.0, 0.5), tile_m=0.2)
    edges = model_edges(compiled(builder, quat=(0.8, 0.0, 0.6, 0.0)))
    corner_low, corner_high = np.array([-0.6, -0.7, 0.65]), np.array([1.4, 0.3, 1.15])
    assert len(edges.part_id) == 12
    points = edges.endpoints_part.reshape(-1, 3)
    assert np.all(np.isclose(points, corner_low, atol=1e-5)
                  | np.isclose(points, corner_high, atol=1e-5))


def test_touching_boxes_share_their_common_edges():
    left, right = MeshBuilder(), MeshBuilder()
    left.box((-0.5, 0.0, 0.0), (1.0, 1.0, 1.0))
    right.box((0.5, 0.0, 0.0), (1.0, 1.0, 1.0))
    edges = model_edges(compiled(left, right))
    # Two cubes side by side: four long edges, and four of 1 m at each of three places along x.
    assert sorted(np.round(lengths(edges), 5).tolist()) == [1.0] * 12 + [2.0] * 4


def test_collinear_edges_with_a_gap_stay_two():
    pair = MeshBuilder()
    for x in (0.0, 2.0):
        pair.quads([[[x, 0, 0], [x + 1, 0, 0], [x + 1, 1, 0], [x, 1, 0]]])
    edges = model_edges(compiled(pair))
    expected = [[(x, y, 0.0), (x + 1, y, 0.0)] for x in (0.0, 2.0) for y in (0.0, 1.0)]
    expected += [[(x, 0.0, 0.0), (x, 1.0, 0.0)] for x in (0.0, 1.0, 2.0, 3.0)]
    assert as_set(edges.endpoints_part) == as_set(expected)


def test_a_round_mesh_has_its_rim_only_if_its_facets_are_long_enough():
    angle = 2.0 * np.pi * np.arange(25) / 24
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    tube = MeshBuilder()
    tube.quads(np.stack([ring[:-1], ring[1:], ring[1:] + up, ring[:-1] + up], axis=1))
    model = compiled(tube)
    assert len(model_edges(model, shortest_m=0.2).part_id) == 48   # two open rims, no seams
    assert len(model_edges(model, shortest_m=0.3).part_id) == 0
    assert len(model_edges(model, edgeless=("plain",)).part_id) == 0
