"""What stands along a road: lamps, signs, bins, trees, gardens."""

from __future__ import annotations

import numpy as np

from simbench.scenes_builtin.houses import TownMeshes, Wall
from slam.geometry.arrays import Array

KERB_M = 0.12
SIDEWALK_M = 2.6
_UP = np.array([0.0, 0.0, 1.0])


def plant_garden(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall, s0: float,
                  s1: float) -> None:
    """A hedge and trees in place of a house."""
    at = np.array(kerb.at((s0 + s1) / 2.0, 0.55, -SIDEWALK_M - 0.5))
    along = np.abs(kerb.along)
    town.box(place, "leaves", at, np.array([*(along * (s1 - s0 - 0.4) + (1.0 - along) * 0.7), 1.1]))
    for s in np.linspace(s0 + 2.0, s1 - 2.0, 2):
        plant_tree(town, rng, place, np.array(kerb.at(float(s), 0.0, -SIDEWALK_M - 4.0)))


def furnish_sidewalk(town: TownMeshes, rng: np.random.Generator, place: str, kerb: Wall,
                      length: float) -> None:
    """Lamps, trees, signs and bins in a row behind the kerb."""
    s = 7.0 + rng.uniform(0.0, 2.0)
    lamp = bool(rng.integers(2))
    while s < length - 7.0:
        foot = np.array(kerb.at(s, 0.0, -0.55))
        if lamp:
            _raise_lamp(town, place, kerb, s)
        else:
            plant_tree(town, rng, place, foot)
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


def plant_tree(town: TownMeshes, rng: np.random.Generator, place: str, foot: Array,
               size: float = 1.0) -> None:
    """A tree; `size` 1 makes it a small one of 4 m, as in a street."""
    trunk = size * rng.uniform(2.0, 2.6)
    thick = size * 0.22
    town.box(place, "bark", foot + _UP * (trunk / 2.0), np.array([thick, thick, trunk]))
    grow_leaves(town, rng, place, foot + _UP * (trunk + size * 1.0), size)


def grow_leaves(town: TownMeshes, rng: np.random.Generator, place: str, centre: Array,
                size: float = 1.0) -> None:
    """A bumpy ball, of 1.2 m radius where `size` is 1: rings of latitude with jittered radii."""
    rings, sides = 6, 9
    v = np.pi * np.arange(rings + 1)[:, None] / rings
    u = 2.0 * np.pi * np.arange(sides + 1)[None, :] / sides
    radius = rng.uniform(0.95, 1.35, size=(rings + 1, sides + 1)) * rng.uniform(0.9, 1.2)
    radius[:, -1] = radius[:, 0]
    radius[0], radius[-1] = radius[0, 0], radius[-1, 0]
    ball = centre + size * radius[..., None] * np.stack(
        [np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), 1.15 * np.cos(v) + 0.0 * u], axis=-1)
    quads = np.stack([ball[1:, :-1], ball[1:, 1:], ball[:-1, 1:], ball[:-1, :-1]], axis=2)
    town.quads(place, "leaves", quads.reshape(-1, 4, 3))
