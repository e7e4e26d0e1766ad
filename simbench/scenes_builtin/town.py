"""The standing part of a street scene: roads, kerbs, houses with windows and doors, trees, lamps.

Two roads along x and two along y enclose a block, as in a noughts-and-crosses board:
    y = 0 and y = HEIGHT_M,  x = 0 and x = WIDTH_M.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from simbench.randomise import jittered_rgba, set_texture
from slam.geometry.arrays import Array

WIDTH_M, HEIGHT_M = 80.0, 64.0
ROAD_M = 5.7              # half a road: a lane of 3.5 m and a parking strip of 2.2 m
LANE_M = 3.5
_BEYOND_M = 34.0          # how far the roads go on beyond the crossings
_KERB_M = 0.12
_SIDEWALK_M = 2.6
_DEPTH_M = 9.0            # of houses
_STOREY_M = 3.0
_REVEAL_M = 0.18          # depth of windows and doors in the wall
_MARK_M = 0.01            # by which markings lie over the road
_FACADES = 7
_FACADE_TEXTURES = ("brick", "plaster", "blocks", "siding", "brick", "concrete", "plaster")
# Texture tiles per metre; materials not named here have one tile to each face.
_TILES = {"road": 0.24, "patch": 0.4, "marking": 0.8, "sidewalk": 0.42, "lawn": 0.5, "trim": 0.7,
          "roof": 0.6, "metal": 1.2, "bark": 1.0, "leaves": 0.7,
          **{f"facade {k}": 0.32 for k in range(_FACADES)}}


class _Town:
    """Mesh builders by neighbourhood and material: near things share a mesh, far ones do not."""

    def __init__(self) -> None:
        self.builders: dict[tuple[str, str], MeshBuilder] = defaultdict(MeshBuilder)

    def quads(self, place: str, material: str, corners: Array,
              shift: tuple[float, float] = (0.0, 0.0)) -> None:
        corners = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
        if material in _TILES:
            self.builders[place, material].quads(corners, None, _TILES[material], shift)
        else:
            uv = np.broadcast_to(np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float),
                                 (len(corners), 4, 2))
            self.builders[place, material].quads(corners, uv)

    def box(self, place: str, material: str, centre: Array, size: Array) -> None:
        fit = material not in _TILES
        self.builders[place, material].box(centre, size, scale=_TILES.get(material, 1.0), fit=fit)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        for (place, material), builder in self.builders.items():
            if len(builder):
                builder.add_to(spec, f"{place} {material}")
                visible_geom(spec.worldbody, f"{place} {material}", material)


@dataclass(frozen=True, slots=True)
class _Wall:
    """An upright plane: s runs to the right along it as seen from outside, z up, out outwards."""

    origin: Array      # (2,) m where s = 0
    along: Array       # (2,) unit
    base: float        # z of z = 0

    def at(self, s: float, z: float, out: float = 0.0) -> list[float]:
        # Outwards is to the right of the wall's direction.
        x, y = self.origin + s * self.along + out * np.array([self.along[1], -self.along[0]])
        return [float(x), float(y), self.base + z]

    def quad(self, s0: float, s1: float, z0: float, z1: float, out: float = 0.0) -> Array:
        return np.array([self.at(s0, z0, out), self.at(s1, z0, out), self.at(s1, z1, out),
                         self.at(s0, z1, out)])

    def slab(self, s0: float, s1: float, z0: float, z1: float, out: float) -> Array:
        """(5, 4, 3): what is seen of a slab of thickness `out` on the wall."""
        a, b = self.quad(s0, s1, z0, z1), self.quad(s0, s1, z0, z1, out)
        sides = [np.array([a[k], a[(k + 1) % 4], b[(k + 1) % 4], b[k]]) for k in range(4)]
        return np.stack([b, *sides])

    def recess(self, s0: float, s1: float, z0: float, z1: float, depth: float) -> Array:
        """(4, 4, 3): the inner sides of a hole in the wall."""
        a, b = self.quad(s0, s1, z0, z1), self.quad(s0, s1, z0, z1, -depth)
        return np.stack([np.array([a[k], a[(k + 1) % 4], b[(k + 1) % 4], b[k]])
                         for k in range(4)])


def build_town(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Build everything that stands still (parked cars apart) into the world body."""
    for number, texture in enumerate(rng.permutation(_FACADE_TEXTURES)):
        set_texture(spec.material(f"facade {number}"), str(texture))
    for material in spec.materials:
        if not material.name.startswith("car"):
            material.rgba = jittered_rgba(rng, material.rgba[:3], 0.12)
    town = _Town()
    _lay_roads(town, rng)
    spans = [_spans(WIDTH_M), _spans(HEIGHT_M)]
    for i, x in enumerate(spans[0]):
        for j, y in enumerate(spans[1]):
            _build_block(town, rng, f"block {i}{j}", x, y,
                         roads=(j > 0, i < 2, j < 2, i > 0))
    _close_roads(town, rng)
    town.add_to(spec)


def _spans(length: float) -> list[tuple[float, float]]:
    """The three stretches between and beyond two roads."""
    return [(-ROAD_M - _BEYOND_M, -ROAD_M), (ROAD_M, length - ROAD_M),
            (length + ROAD_M, length + ROAD_M + _BEYOND_M)]


def _flat(x0: float, x1: float, y0: float, y1: float, z: float) -> Array:
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def _lay_roads(town: _Town, rng: np.random.Generator) -> None:
    end_x = WIDTH_M + ROAD_M + _BEYOND_M
    for y in (0.0, HEIGHT_M):
        town.quads("roads", "road", _flat(-ROAD_M - _BEYOND_M, end_x, y - ROAD_M, y + ROAD_M, 0.0))
    for x in (0.0, WIDTH_M):
        for y0, y1 in _spans(HEIGHT_M):
            town.quads("roads", "road", _flat(x - ROAD_M, x + ROAD_M, y0, y1, 0.0))
    for axis, length, others in ((0, WIDTH_M, (0.0, HEIGHT_M)), (1, HEIGHT_M, (0.0, WIDTH_M))):
        for across in others:
            for low, high in _spans(length):
                _mark_road(town, rng, axis, across, low, high,
                           crossings=(low > -ROAD_M, high < length + 2 * ROAD_M))


def _mark_road(town: _Town, rng: np.random.Generator, axis: int, across: float, low: float,
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


def _build_block(town: _Town, rng: np.random.Generator, place: str, x: tuple[float, float],
                 y: tuple[float, float], roads: tuple[bool, bool, bool, bool]) -> None:
    """Kerb, sidewalk and houses; `roads`: is there one in the south, east, north, west."""
    corners = [np.array(c) for c in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))]
    inset = _SIDEWALK_M
    yard = _flat(x[0] + inset, x[1] - inset, y[0] + inset, y[1] - inset, _KERB_M)
    town.quads(place, "lawn", yard)
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        inner_a, inner_b = yard[k], yard[(k + 1) % 4]
        if not roads[k]:
            town.quads(place, "lawn", np.array([[*a, _KERB_M], [*b, _KERB_M], inner_b, inner_a]))
            continue
        town.quads(place, "sidewalk", np.array([[*a, _KERB_M], [*b, _KERB_M], inner_b, inner_a]))
        town.quads(place, "trim", np.array([[*a, 0.0], [*b, 0.0], [*b, _KERB_M], [*a, _KERB_M]]))
        length = float(np.linalg.norm(b - a))
        wall = _Wall(a, (b - a) / length, _KERB_M)
        row = f"{place} row {k}"
        _furnish_sidewalk(town, rng, f"{row} kerb", wall, length)
        # The houses in the south and north rows hold the corners of the block.
        holds = k % 2 == 0
        start = inset if holds else (inset + _DEPTH_M if roads[k - 1] else 0.0)
        stop = length - (inset if holds else (inset + _DEPTH_M if roads[(k + 1) % 4] else 0.0))
        _build_row(town, rng, row, wall, start, stop, inset)


def _build_row(town: _Town, rng: np.random.Generator, place: str, kerb: _Wall, start: float,
               stop: float, inset: float) -> None:
    """Houses side by side along a sidewalk, now and then a garden."""
    count = max(1, round((stop - start) / 11.0))
    share = rng.uniform(0.75, 1.25, count)
    cuts = start + (stop - start) * np.concatenate([[0.0], np.cumsum(share) / share.sum()])
    for number, (s0, s1) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        edge = number in {0, count - 1}
        if not edge and rng.uniform() < 0.14:
            _plant_garden(town, rng, place, kerb, s0, s1)
        else:
            origin = np.array(kerb.at(float(s0), 0.0, -inset)[:2])
            _build_house(town, rng, place, _Wall(origin, kerb.along, _KERB_M), float(s1 - s0),
                         flanks=(number == count - 1, number == 0))


def _build_house(town: _Town, rng: np.random.Generator, place: str, front: _Wall,
                 width: float, flanks: tuple[bool, bool] = (False, False)) -> None:
    """A house `width` wide; `flanks`: has it windows on its right and on its left side?"""
    material = f"facade {rng.integers(_FACADES)}"
    storeys = int(rng.integers(2, 5))
    height = storeys * _STOREY_M + 0.7
    shop, sills = rng.uniform() < 0.35, rng.uniform() < 0.6
    shift = (float(rng.uniform()), float(rng.uniform()))
    sides = [front]
    for length in (width, _DEPTH_M, width):
        last = sides[-1]
        corner = np.array(last.at(length, 0.0)[:2])
        sides.append(_Wall(corner, np.array([-last.along[1], last.along[0]]), last.base))
    for k, wall in enumerate(sides):
        length = width if k % 2 == 0 else _DEPTH_M
        if k == 0:
            _build_facade(town, rng, place, wall, length, storeys, material, shop, sills, shift)
        elif k % 2 == 1 and flanks[k // 2]:
            _build_facade(town, rng, place, wall, length, storeys, material, False, False, shift,
                          doors=False)
        else:
            town.quads(place, material, wall.quad(0.0, length, 0.0, height), shift)
    top = [np.array(wall.at(0.0, height)) for wall in sides]
    town.quads(place, "roof", np.stack(top))
    town.quads(place, "trim", front.slab(0.02, width - 0.02, height - 0.42, height - 0.12, 0.22))
    town.quads(place, "trim", front.slab(0.02, width - 0.02, _STOREY_M + 0.02, _STOREY_M + 0.22,
                                         0.08))


def _build_facade(town: _Town, rng: np.random.Generator, place: str, wall: _Wall, width: float,
                  storeys: int, material: str, shop: bool, sills: bool,
                  shift: tuple[float, float], doors: bool = True) -> None:
    """A wall with windows and a door set back into it; all corners meet, nothing overlaps."""
    columns = max(1, int((width - 0.8) / 2.5))
    half = 0.5 * float(rng.uniform(1.0, 1.35))
    middle = (np.arange(columns) + 0.5) * width / columns
    s = np.concatenate([[0.0], np.stack([middle - half, middle + half], -1).ravel(), [width]])
    heads = np.array([[_STOREY_M * k + (0.95 if k or not shop else 0.5),
                       _STOREY_M * k + (2.45 if k or not shop else 2.6)] for k in range(storeys)])
    z = np.concatenate([[0.0], heads.ravel(), [storeys * _STOREY_M + 0.7]])
    door = int(rng.integers(columns)) if doors else -1
    roller = int(rng.integers(columns)) if doors and rng.uniform() < 0.4 else -1
    for i in range(len(s) - 1):
        for j in range(len(z) - 1):
            column, storey = i // 2, j // 2
            opening = i % 2 == 1 and column in {door, roller} and j < 2
            if opening and j == 0:
                town.quads(place, material, wall.recess(s[i], s[i + 1], 0.0, z[2], _REVEAL_M)[1:],
                           shift)
                town.quads(place, "door" if column == door else "roller",
                           wall.quad(s[i], s[i + 1], 0.0, z[2], -_REVEAL_M))
            elif i % 2 == 1 and j % 2 == 1 and not opening:
                town.quads(place, material, wall.recess(s[i], s[i + 1], z[j], z[j + 1], _REVEAL_M),
                           shift)
                town.quads(place, "pane", wall.quad(s[i], s[i + 1], z[j], z[j + 1], -_REVEAL_M))
                if sills:
                    town.quads(place, "trim", wall.slab(
                        s[i] - 0.1, s[i + 1] + 0.1, z[j] - 0.12, z[j] - 0.02, 0.11))
            elif not opening:
                town.quads(place, material, wall.quad(s[i], s[i + 1], z[j], z[j + 1]), shift)
            if storey == 0 and shop and doors and j == 2 and i % 2 == 1:
                town.quads(place, f"sign {'ab'[column % 2]}", wall.slab(
                    s[i] - 0.05, s[i + 1] + 0.05, z[2] + 0.06, z[2] + 0.36, 0.10))


def _plant_garden(town: _Town, rng: np.random.Generator, place: str, kerb: _Wall, s0: float,
                  s1: float) -> None:
    """A hedge and trees in place of a house."""
    at = np.array(kerb.at((s0 + s1) / 2.0, 0.55, -_SIDEWALK_M - 0.5))
    along = np.abs(kerb.along)
    town.box(place, "leaves", at, np.array([*(along * (s1 - s0 - 0.4) + (1.0 - along) * 0.7), 1.1]))
    for s in np.linspace(s0 + 2.0, s1 - 2.0, 2):
        _plant_tree(town, rng, place, np.array(kerb.at(float(s), 0.0, -_SIDEWALK_M - 4.0)))


def _furnish_sidewalk(town: _Town, rng: np.random.Generator, place: str, kerb: _Wall,
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
                town.box(place, "metal", at + [0.0, 0.0, 0.45], np.array([0.45, 0.45, 0.9]))
            else:
                _raise_sign(town, rng, place, kerb, s + 2.2)
        lamp, s = not lamp, s + rng.uniform(6.5, 9.5)


def _raise_lamp(town: _Town, place: str, kerb: _Wall, s: float) -> None:
    post = kerb.at(s, 2.6, -0.5)
    arm = np.array(kerb.at(s, 5.26, 0.2))
    across = np.abs([kerb.along[1], kerb.along[0]])
    town.box(place, "metal", np.array(post), np.array([0.13, 0.13, 5.2]))
    town.box(place, "metal", np.array(kerb.at(s, 0.2, -0.5)), np.array([0.26, 0.26, 0.4]))
    town.box(place, "metal", arm, np.array([*(across * 1.6 + (1.0 - across) * 0.10), 0.12]))
    town.box(place, "trim", arm + [0.0, 0.0, -0.1], np.array([0.3, 0.3, 0.08]))


def _raise_sign(town: _Town, rng: np.random.Generator, place: str, kerb: _Wall, s: float) -> None:
    town.box(place, "metal", np.array(kerb.at(s, 1.1, -0.5)), np.array([0.07, 0.07, 2.2]))
    along = np.abs(kerb.along)
    size = np.array([*((1.0 - along) * 0.7 + along * 0.05), 0.7])
    town.box(place, f"sign {'ab'[int(rng.integers(2))]}", np.array(kerb.at(s, 2.5, -0.5)), size)


def _plant_tree(town: _Town, rng: np.random.Generator, place: str, foot: Array) -> None:
    trunk = rng.uniform(2.0, 2.6)
    town.box(place, "bark", foot + [0.0, 0.0, trunk / 2.0], np.array([0.22, 0.22, trunk]))
    centre = foot + [0.0, 0.0, trunk + 1.0]
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


def _close_roads(town: _Town, rng: np.random.Generator) -> None:
    """A house across the end of every road, so that no road runs into nothing."""
    wide = 2.0 * (ROAD_M + 7.0)
    for y in (0.0, HEIGHT_M):
        for x, turn in ((-ROAD_M - _BEYOND_M, 1.0), (WIDTH_M + ROAD_M + _BEYOND_M, -1.0)):
            origin = np.array([x, y - turn * wide / 2.0])
            _build_house(town, rng, f"end {x:.0f} {y:.0f}",
                         _Wall(origin, np.array([0.0, turn]), 0.0), wide)
    for x in (0.0, WIDTH_M):
        for y, turn in ((-ROAD_M - _BEYOND_M, 1.0), (HEIGHT_M + ROAD_M + _BEYOND_M, -1.0)):
            origin = np.array([x + turn * wide / 2.0, y])
            _build_house(town, rng, f"end {x:.0f} {y:.0f}",
                         _Wall(origin, np.array([-turn, 0.0]), 0.0), wide)
