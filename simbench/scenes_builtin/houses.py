"""Houses with windows and doors set back in their walls, as quads gathered by material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simbench.meshes import PlacedMeshes
from slam.geometry.arrays import Array

HOUSE_DEPTH_M = 9.0
FACADES = 7               # materials "facade 0" to "facade 6"
_STOREY_M = 3.0
_REVEAL_M = 0.18          # depth of windows and doors in the wall
# Texture tiles per metre; materials not named here have one tile to each face.
_TILES = {"road": 0.24, "patch": 0.4, "marking": 0.8, "sidewalk": 0.42, "lawn": 0.5, "trim": 0.7,
          "roof": 0.6, "metal": 1.2, "bark": 1.0, "leaves": 0.7,
          **{f"facade {k}": 0.32 for k in range(FACADES)}}


@dataclass(frozen=True, slots=True)
class HouseStyle:
    """Materials of a house."""

    facade: str
    pane: str = "pane"
    door: str = "door"
    signs: tuple[str, str] = ("sign a", "sign b")


def any_facade(rng: np.random.Generator) -> HouseStyle:
    """One of the facades, which other houses may have, too."""
    return HouseStyle(f"facade {rng.integers(FACADES)}")


class TownMeshes(PlacedMeshes):
    """The meshes of a town, and how its houses look."""

    def __init__(self, draw_style: Callable[[np.random.Generator], HouseStyle] = any_facade
                 ) -> None:
        super().__init__(_TILES)
        self.draw_style = draw_style    # of the next house


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright plane: s runs to the right along it as seen from outside, z up, out outwards."""

    origin: Array      # (2,) m where s = 0
    along: Array       # (2,) unit
    base: float        # z of z = 0

    def at(self, s: float, z: float, out: float = 0.0) -> list[float]:
        # Outwards is to the right of the wall's direction.
        (x, y), (dx, dy) = self.origin.tolist(), self.along.tolist()
        return [x + s * dx + out * dy, y + s * dy - out * dx, self.base + z]

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


def build_house(town: TownMeshes, rng: np.random.Generator, place: str, front: Wall,
                 width: float, flanks: tuple[bool, bool] = (False, False)) -> None:
    """A house `width` wide; `flanks`: has it windows on its right and on its left side?"""
    style = town.draw_style(rng)
    storeys = int(rng.integers(2, 5))
    height = storeys * _STOREY_M + 0.7
    shop, sills = rng.uniform() < 0.35, rng.uniform() < 0.6
    shift = (float(rng.uniform()), float(rng.uniform()))
    sides = [front]
    for length in (width, HOUSE_DEPTH_M, width):
        last = sides[-1]
        corner = np.array(last.at(length, 0.0)[:2])
        sides.append(Wall(corner, np.array([-last.along[1], last.along[0]]), last.base))
    for k, wall in enumerate(sides):
        length = width if k % 2 == 0 else HOUSE_DEPTH_M
        if k == 0:
            _build_facade(town, rng, place, wall, length, storeys, style, shop, sills, shift)
        elif k % 2 == 1 and flanks[k // 2]:
            _build_facade(town, rng, place, wall, length, storeys, style, False, False, shift,
                          doors=False)
        else:
            town.quads(place, style.facade, wall.quad(0.0, length, 0.0, height), shift)
    top = [np.array(wall.at(0.0, height)) for wall in sides]
    town.quads(place, "roof", np.stack(top))
    town.quads(place, "trim", front.slab(0.02, width - 0.02, height - 0.42, height - 0.12, 0.22))
    town.quads(place, "trim", front.slab(0.02, width - 0.02, _STOREY_M + 0.02, _STOREY_M + 0.22,
                                         0.08))


def _build_facade(town: TownMeshes, rng: np.random.Generator, place: str, wall: Wall, width: float,
                  storeys: int, style: HouseStyle, shop: bool, sills: bool,
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
                hole = wall.recess(s[i], s[i + 1], 0.0, z[2], _REVEAL_M)
                town.quads(place, style.facade, hole[1:], shift)
                town.quads(place, style.door if column == door else "roller",
                           wall.quad(s[i], s[i + 1], 0.0, z[2], -_REVEAL_M))
            elif i % 2 == 1 and j % 2 == 1 and not opening:
                hole = wall.recess(s[i], s[i + 1], z[j], z[j + 1], _REVEAL_M)
                town.quads(place, style.facade, hole, shift)
                town.quads(place, style.pane, wall.quad(s[i], s[i + 1], z[j], z[j + 1], -_REVEAL_M))
                if sills:
                    town.quads(place, "trim", wall.slab(
                        s[i] - 0.1, s[i + 1] + 0.1, z[j] - 0.12, z[j] - 0.02, 0.11))
            elif not opening:
                town.quads(place, style.facade, wall.quad(s[i], s[i + 1], z[j], z[j + 1]), shift)
            if storey == 0 and shop and doors and j == 2 and i % 2 == 1:
                town.quads(place, style.signs[column % 2], wall.slab(
                    s[i] - 0.05, s[i + 1] + 0.05, z[2] + 0.06, z[2] + 0.36, 0.10))
