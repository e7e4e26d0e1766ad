"""The standing part of a street scene: roads, kerbs, houses with windows and doors, trees, lamps.

Two roads along x and two along y enclose a block, as in a noughts-and-crosses board:
    y = 0 and y = height_m,  x = 0 and x = width_m.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from simbench.randomise import jittered_rgba, set_texture
from simbench.scenes_builtin.houses import (
    HOUSE_DEPTH_M,
    TownMeshes,
    Wall,
    build_house,
)
from slam.geometry.arrays import Array

ROAD_M = 5.7              # half a road: a lane of 3.5 m and a parking strip of 2.2 m
LANE_M = 3.5
_BEYOND_M = 34.0          # how far the roads go on beyond the crossings
KERB_M = 0.12
SIDEWALK_M = 2.6
_MARK_M = 0.01            # by which markings lie over the road
_UP = np.array([0.0, 0.0, 1.0])
_FACADE_TEXTURES = ("brick", "plaster", "blocks", "siding", "brick", "concrete", "plaster")


@dataclass(frozen=True, slots=True)
class TownPlan:
    """How far apart (m) the middles of the two pairs of roads are."""

    width_m: float
    height_m: float


def choose_facades(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Give the facade materials of the MJCF file their textures."""
    for number, texture in enumerate(rng.permutation(_FACADE_TEXTURES)):
        set_texture(spec.material(f"facade {number}"), str(texture))


def build_town(spec: mujoco.MjSpec, rng: np.random.Generator, plan: TownPlan, town: TownMeshes
               ) -> None:
    """Build everything that stands still (parked cars apart) into the world body."""
    for material in spec.materials:
        if not material.name.startswith("car"):
            material.rgba = jittered_rgba(rng, material.rgba[:3], 0.12)
    _lay_roads(town, rng, plan)
    spans = [_spans(plan.width_m), _spans(plan.height_m)]
    for i, x in enumerate(spans[0]):
        for j, y in enumerate(spans[1]):
            _build_block(town, rng, f"block {i}{j}", x, y,
                         roads=(j > 0, i < 2, j < 2, i > 0))
    _close_roads(town, rng, plan)
    town.add_to(spec)


def _spans(length: float) -> list[tuple[float, float]]:
    """The three stretches between and beyond two roads."""
    return [(-ROAD_M - _BEYOND_M, -ROAD_M), (ROAD_M, length - ROAD_M),
            (length + ROAD_M, length + ROAD_M + _BEYOND_M)]


def _flat(x0: float, x1: float, y0: float, y1: float, z: float) -> Array:
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def _lay_roads(town: TownMeshes, rng: np.random.Generator, plan: TownPlan) -> None:
    width, height = plan.width_m, plan.height_m
    end_x = width + ROAD_M + _BEYOND_M
    for y in (0.0, height):
        town.quads("roads", "road", _flat(-ROAD_M - _BEYOND_M, end_x, y - ROAD_M, y + ROAD_M, 0.0))
    for x in (0.0, width):
        for y0, y1 in _spans(height):
            town.quads("roads", "road", _flat(x - ROAD_M, x + ROAD_M, y0, y1, 0.0))
    for axis, length, others in ((0, width, (0.0, height)), (1, height, (0.0, width))):
        for across in others:
            for low, high in _spans(length):
                _mark_road(town, rng, axis, across, low, high,
                           crossings=(low > -ROAD_M, high < length + 2 * ROAD_M))


def _mark_road(town: TownMeshes, rng: np.random.Generator, axis: int, across: float, low: float,
               high: float, crossings: tuple[bool, bool]) -> None:
    """Markings and mended patches of a stretch of road along x (axis 0) or y (axis 1)."""

    def mark(a0: float, a1: float, c0: float, c1: float, material: str = "marking",
             z: float = _MARK_M) -> None:
        c0, c1 = across + c0, across + c1
        town.quads("roads", material, _flat(a0, a1, c0, c1, z) if axis == 0
                   else _flat(c0, c1, a0, a1, z))

    first, last = low + (6.5 if crossings[0] else 0.0), high - (6.5 if crossings[1] else 0.0)
    for at in np.arange(first, last - 3.0, 6.0):
        mark(at, at + 3.0, -0.07, 0.07)
    for side in (-LANE_M - 0.05, LANE_M + 0.05):
        mark(first, last, side - 0.06, side + 0.06)
    for crossing, at in zip(crossings, (low, high), strict=True):
        if crossing:
            inward = 1.0 if at == low else -1.0
            stripes = sorted((at + inward * 1.0, at + inward * 4.0))
            for c in np.arange(-ROAD_M + 0.6, ROAD_M - 0.5, 1.0):
                mark(stripes[0], stripes[1], c, c + 0.5)
            right = inward if axis == 0 else -inward   # of those who come to this crossing
            lane = sorted((0.1 * right, right * LANE_M))
            stop = sorted((at + inward * 5.0, at + inward * 5.4))
            mark(stop[0], stop[1], lane[0], lane[1])
    for a in np.arange(first, last - 4.5, 4.5):   # one in each stretch: none overlap
        if rng.uniform() < 0.6:
            a0, c0 = a + rng.uniform(0.0, 2.0), rng.uniform(-ROAD_M + 0.3, ROAD_M - 2.3)
            mark(a0, a0 + rng.uniform(0.6, 2.4), c0, c0 + rng.uniform(0.6, 1.9), "patch", 0.004)


def _build_block(town: TownMeshes, rng: np.random.Generator, place: str, x: tuple[float, float],
                 y: tuple[float, float], roads: tuple[bool, bool, bool, bool]) -> None:
    """Kerb, sidewalk and houses; `roads`: is there one in the south, east, north, west."""
    corners = [np.array(c) for c in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))]
    inset = SIDEWALK_M
    yard = _flat(x[0] + inset, x[1] - inset, y[0] + inset, y[1] - inset, KERB_M)
    town.quads(place, "lawn", yard)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        inner_a, inner_b = yard[k], yard[(k + 1) % 4]
        if not roads[k]:
            town.quads(place, "lawn", np.array([[*a, KERB_M], [*b, KERB_M], inner_b, inner_a]))
            continue
        town.quads(place, "sidewalk", np.array([[*a, KERB_M], [*b, KERB_M], inner_b, inner_a]))
        town.quads(place, "trim", np.array([[*a, 0.0], [*b, 0.0], [*b, KERB_M], [*a, KERB_M]]))
        length = float(np.linalg.norm(b - a))
        wall = Wall(a, (b - a) / length, KERB_M)
        row = f"{place} row {k}"
        _furnish_sidewalk(town, rng, f"{row} kerb", wall, length)
        # The houses in the south and north rows hold the corners of the block.
        holds = k % 2 == 0
        start = inset if holds else (inset + HOUSE_DEPTH_M if roads[k - 1] else 0.0)
        stop = length - (inset if holds else (inset + HOUSE_DEPTH_M if roads[(k + 1) % 4] else 0.0))
        _build_row(town, rng, row, wall, start, stop, inset)


def _build_row(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, start: float,
               stop: float, inset: float) -> None:
    """Houses side by side along a sidewalk, now and then a garden."""
    count = max(1, round((stop - start) / 11.0))
    share = rng.uniform(0.75, 1.25, count)
    cuts = start + (stop - start) * np.concatenate([[0.0], np.cumsum(share) / share.sum()])
    for number, (s0, s1) in enumerate(pairwise(cuts)):
        edge = number in {0, count - 1}
        if not edge and rng.uniform() < 0.14:
            _plant_garden(town, rng, place, kerb, s0, s1)
        else:
            origin = np.array(kerb.at(float(s0), 0.0, -inset)[:2])
            build_house(town, rng, place, Wall(origin, kerb.along, KERB_M), float(s1 - s0),
                         flanks=(number == count - 1, number == 0))


def _plant_garden(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, s0: float,
                  s1: float) -> None:
    """A hedge and trees in place of a house."""
    at = np.array(kerb.at((s0 + s1) / 2.0, 0.55, -SIDEWALK_M - 0.5))
    along = np.abs(kerb.along)
    town.box(place, "leaves", at, np.array([*(along * (s1 - s0 - 0.4) + (1.0 - along) * 0.7), 1.1]))
    for s in np.linspace(s0 + 2.0, s1 - 2.0, 2):
        _plant_tree(town, rng, place, np.array(kerb.at(float(s), 0.0, -SIDEWALK_M - 4.0)))


def _furnish_sidewalk(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall,
                      length: float) -> None:
    """Lamps, trees, signs and bins in a row behind the kerb."""
    s = 7.0 + rng.uniform(0.0, 2.0)
    lamp = bool(rng.integers(2))
    while s < length - 7.0:
        foot = np.array(kerb.at(s, 0.0, -0.55))
        if lamp:
            _raise_lamp(town, place, kerb, s)
        else:
            _plant_tree(town, rng, place, foot)
        if rng.uniform() < 0.6:
            at = np.array(kerb.at(s + 2.2, 0.0, -0.6))
            if rng.uniform() < 0.5:
                town.box(place, "metal", at + _UP * 0.45, np.array([0.45, 0.45, 0.9]))
            else:
                _raise_sign(town, rng, place, kerb, s + 2.2)
        lamp, s = not lamp, s + rng.uniform(6.5, 9.5)


def _raise_lamp(town: TownMeshes, place: str, kerb: Wall, s: float) -> None:
    post = kerb.at(s, 2.6, -0.5)
    arm = np.array(kerb.at(s, 5.26, 0.2))
    across = np.abs([kerb.along[1], kerb.along[0]])
    town.box(place, "metal", np.array(post), np.array([0.13, 0.13, 5.2]))
    town.box(place, "metal", np.array(kerb.at(s, 0.2, -0.5)), np.array([0.26, 0.26, 0.4]))
    town.box(place, "metal", arm, np.array([*(across * 1.6 + (1.0 - across) * 0.10), 0.12]))
    town.box(place, "trim", arm - _UP * 0.1, np.array([0.3, 0.3, 0.08]))


def _raise_sign(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall,
                s: float) -> None:
    town.box(place, "metal", np.array(kerb.at(s, 1.1, -0.5)), np.array([0.07, 0.07, 2.2]))
    along = np.abs(kerb.along)
    size = np.array([*((1.0 - along) * 0.7 + along * 0.05), 0.7])
    town.box(place, f"sign {'ab'[int(rng.integers(2))]}", np.array(kerb.at(s, 2.5, -0.5)), size)


def _plant_tree(town: TownMeshes, rng: np.random.Generator, place: str, foot: Array) -> None:
    trunk = rng.uniform(2.0, 2.6)
    town.box(place, "bark", foot + _UP * (trunk / 2.0), np.array([0.22, 0.22, trunk]))
    centre = foot + _UP * (trunk + 1.0)
    # A bumpy ball: rings of latitude with jittered radii.
    rings, sides = 6, 9
    v = np.pi * np.arange(rings + 1)[:, None] / rings
    u = 2.0 * np.pi * np.arange(sides + 1)[None, :] / sides
    radius = rng.uniform(0.95, 1.35, size=(rings + 1, sides + 1)) * rng.uniform(0.9, 1.2)
    radius[:, -1] = radius[:, 0]
    radius[0], radius[-1] = radius[0, 0], radius[-1, 0]
    ball = centre + radius[..., None] * np.stack(
        [np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), 1.15 * np.cos(v) + 0.0 * u], axis=-1)
    quads = np.stack([ball[1:, :-1], ball[1:, 1:], ball[:-1, 1:], ball[:-1, :-1]], axis=2)
    town.quads(place, "leaves", quads.reshape(-1, 4, 3))


def _close_roads(town: TownMeshes, rng: np.random.Generator, plan: TownPlan) -> None:
    """A house across the end of every road, so that no road runs into nothing."""
    width, height = plan.width_m, plan.height_m
    wide = 2.0 * (ROAD_M + 7.0)
    for y in (0.0, height):
        for x, turn in ((-ROAD_M - _BEYOND_M, 1.0), (width + ROAD_M + _BEYOND_M, -1.0)):
            origin = np.array([x, y - turn * wide / 2.0])
            build_house(town, rng, f"end {x:.0f} {y:.0f}",
                         Wall(origin, np.array([0.0, turn]), 0.0), wide)
    for x in (0.0, width):
        for y, turn in ((-ROAD_M - _BEYOND_M, 1.0), (height + ROAD_M + _BEYOND_M, -1.0)):
            origin = np.array([x + turn * wide / 2.0, y])
            build_house(town, rng, f"end {x:.0f} {y:.0f}",
                         Wall(origin, np.array([-turn, 0.0]), 0.0), wide)
