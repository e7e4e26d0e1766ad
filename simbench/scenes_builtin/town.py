"""The standing part of a street scene: roads, kerbs, and what lies beside them.

Two roads along x and two along y enclose a block, as in a noughts-and-crosses board:
    y = 0 and y = height_m,  x = 0 and x = width_m.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from simbench.randomise import jittered_rgba, set_texture
from simbench.scenes_builtin.countryside import enclose, leave_open, plant_avenue, set_posts
from simbench.scenes_builtin.houses import (
    HOUSE_DEPTH_M,
    TownMeshes,
    Wall,
    build_house,
)
from simbench.scenes_builtin.roadside import (
    KERB_M,
    SIDEWALK_M,
    furnish_sidewalk,
    plant_garden,
)
from slam.geometry.arrays import Array

ROAD_M = 5.7              # half a road: a lane of 3.5 m and a parking strip of 2.2 m
LANE_M = 3.5
_BEYOND_M = 34.0          # how far the roads go on beyond the crossings
_MARK_M = 0.01            # by which markings lie over the road
SURROUNDINGS = ("houses", "open", "trees")
_FACADE_TEXTURES = ("brick", "plaster", "blocks", "siding", "brick", "concrete", "plaster")


@dataclass(frozen=True, slots=True)
class TownPlan:
    """How far apart (m) the middles of the two pairs of roads are, and what stands beside them."""

    width_m: float
    height_m: float
    surroundings: str = "houses"    # one of SURROUNDINGS


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
                         (j > 0, i < 2, j < 2, i > 0), plan.surroundings)
    if plan.surroundings == "houses":
        _close_roads(town, rng, plan)
    else:
        beyond = ROAD_M + _BEYOND_M
        enclose(town, rng, (-beyond, plan.width_m + beyond), (-beyond, plan.height_m + beyond))
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
                 y: tuple[float, float], roads: tuple[bool, bool, bool, bool],
                 surroundings: str) -> None:
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
        paved = "lawn" if surroundings == "open" else "sidewalk"
        town.quads(place, paved, np.array([[*a, KERB_M], [*b, KERB_M], inner_b, inner_a]))
        town.quads(place, "trim", np.array([[*a, 0.0], [*b, 0.0], [*b, KERB_M], [*a, KERB_M]]))
        length = float(np.linalg.norm(b - a))
        wall = Wall(a, (b - a) / length, KERB_M)
        row = f"{place} row {k}"
        if surroundings == "open":
            set_posts(town, rng, f"{row} kerb", wall, length)
            leave_open(town, rng, row, wall, length)
            continue
        if surroundings == "trees":
            plant_avenue(town, rng, row, wall, length)
            continue
        furnish_sidewalk(town, rng, f"{row} kerb", wall, length)
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
            plant_garden(town, rng, place, kerb, s0, s1)
        else:
            origin = np.array(kerb.at(float(s0), 0.0, -inset)[:2])
            build_house(town, rng, place, Wall(origin, kerb.along, KERB_M), float(s1 - s0),
                         flanks=(number == count - 1, number == 0))


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
