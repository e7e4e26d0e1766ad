"""Roads without houses: open fields, and avenues of trees, with woods at the horizon."""

from __future__ import annotations

import numpy as np

from simbench.scenes_builtin.houses import TownMeshes, Wall
from simbench.scenes_builtin.roadside import grow_leaves, plant_tree
from slam.geometry.arrays import Array

_WOOD_M = 2.8             # between the crowns of a wood's edge


def set_posts(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, length: float
              ) -> None:
    """White posts with a dark band along an open road."""
    for s in np.arange(rng.uniform(3.0, 8.0), length - 2.0, 12.0):
        for z, height, material in ((0.40, 0.80, "trim"), (0.88, 0.16, "metal"),
                                    (1.00, 0.08, "trim")):
            town.box(place, material, np.array(kerb.at(float(s), z, -0.5)),
                     np.array([0.13, 0.13, height]))


def leave_open(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, length: float
               ) -> None:
    """A field: perhaps a fence, a few bushes, far off a tree."""
    if rng.uniform() < 0.6:
        _fence(town, place, kerb, rng.uniform(2.0, 4.5), length)
    for _ in range(rng.poisson(length / 16.0)):
        s, off, size = rng.uniform(6.0, length - 6.0), rng.uniform(6.0, 10.0), rng.uniform(0.4, 0.9)
        grow_leaves(town, rng, place, np.array(kerb.at(float(s), 0.5 * size, -off)), size)
    for _ in range(rng.poisson(length / 35.0)):
        s, off = rng.uniform(12.0, max(13.0, length - 12.0)), rng.uniform(11.0, 15.0)
        plant_tree(town, rng, place, np.array(kerb.at(float(s), 0.0, -off)), rng.uniform(1.2, 1.9))


def plant_avenue(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, length: float
                 ) -> None:
    """Tall trees behind the sidewalk, more of them behind those, and undergrowth."""
    for off, apart in ((3.4, 6.5), (8.0, 6.0)):
        for s in np.arange(rng.uniform(3.5, 6.0), length - 3.0, apart):
            foot = np.array(kerb.at(float(s + rng.uniform(-1.0, 1.0)), 0.0,
                                    -off - rng.uniform(0.0, 1.2)))
            plant_tree(town, rng, place, foot, rng.uniform(1.3, 1.9))
    for s in np.arange(3.0, length - 2.0, 3.2):
        if rng.uniform() < 0.6:
            at = kerb.at(float(s), 0.3, -rng.uniform(5.5, 7.0))
            grow_leaves(town, rng, place, np.array(at), rng.uniform(0.5, 0.9))


def enclose(town: TownMeshes, rng: np.random.Generator, x: tuple[float, float],
            y: tuple[float, float]) -> None:
    """The edge of a wood all round, so that no road runs into nothing."""
    corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]
    for number in range(4):
        a, b = np.array(corners[number]), np.array(corners[(number + 1) % 4])
        count = round(float(np.linalg.norm(b - a)) / _WOOD_M)
        for step in range(count):
            at: Array = a + (step + rng.uniform(-0.2, 0.2)) / count * (b - a)
            size = rng.uniform(2.0, 3.6)
            grow_leaves(town, rng, f"wood {number}", np.array([*at, 0.5 * size]), size)


def _fence(town: TownMeshes, place: str, kerb: Wall, off_m: float, length: float) -> None:
    along = np.abs(kerb.along)
    first, last = 5.0, length - 5.0
    for s in np.arange(first, last, 3.0):
        town.box(place, "bark", np.array(kerb.at(float(s), 0.6, -off_m)),
                 np.array([0.12, 0.12, 1.2]))
    size = np.array([*(along * (last - first) + (1.0 - along) * 0.05), 0.12])
    for z in (0.5, 0.95):
        town.box(place, "bark", np.array(kerb.at(0.5 * (first + last), z, -off_m)), size)
