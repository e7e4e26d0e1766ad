"""The standing part of a corridor: walls with doors set back in them, skirting, rails, lamps."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np

from simbench.meshes import PlacedMeshes
from simbench.randomise import jittered_rgba, set_texture
from simbench.scenes_builtin.houses import Wall
from slam.geometry.arrays import Array

LENGTH_M, WIDTH_M, HEIGHT_M = 30.0, 2.4, 2.6
_DOOR_M = (0.96, 2.08)       # width and height
_REVEAL_M = 0.14             # by which doors are set back
_BAND_M = 1.05               # the lower part of the walls is painted
_TILES = {"floor": 0.5, "joint": 0.8, "ceiling": 0.35, "wall": 0.4, "wall low": 0.4,
          "skirting": 0.8, "rail": 0.8, "frame": 0.8, "duct": 0.8, "metal": 1.2}
_LOOKS = {"floor": ("concrete", "pavers", "planks"), "wall": ("plaster", "concrete"),
          "wall low": ("plaster", "siding", "concrete"),
          "board": ("poster_a", "poster_b", "poster_c", "poster_d"),
          "sign": ("poster_a", "poster_b", "poster_c", "poster_d")}


def build_corridor(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Build everything that stands still: x from 0 to LENGTH_M, y about 0, floor at z = 0."""
    for material, textures in _LOOKS.items():
        set_texture(spec.material(material), str(rng.choice(textures)))
    for each in spec.materials:
        each.rgba = jittered_rgba(rng, each.rgba[:3], 0.10)
    shell, half = PlacedMeshes(_TILES), WIDTH_M / 2.0
    _lay_floor(shell)
    _hang_ceiling(shell, rng)
    walls = (Wall(np.array([LENGTH_M, -half]), np.array([-1.0, 0.0]), 0.0),
             Wall(np.array([0.0, half]), np.array([1.0, 0.0]), 0.0))
    railed = rng.integers(1, 4)      # on one side, the other, or both
    for number, wall in enumerate(walls):
        _build_side(shell, rng, f"side {number}", wall, rail=bool(railed >> number & 1))
    for number, wall in enumerate((Wall(np.array([0.0, -half]), np.array([0.0, 1.0]), 0.0),
                                   Wall(np.array([LENGTH_M, half]), np.array([0.0, -1.0]), 0.0))):
        _build_end(shell, f"end {number}", wall)
    shell.add_to(spec)


def _flat(x0: float, x1: float, y0: float, y1: float, z: float) -> Array:
    return np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])


def _lay_floor(shell: PlacedMeshes) -> None:
    half = WIDTH_M / 2.0
    shell.quads("floor", "floor", _flat(0.0, LENGTH_M, -half, half, 0.0))
    for x in np.arange(1.2, LENGTH_M - 0.6, 1.2):
        shell.quads("floor", "joint", _flat(x - 0.012, x + 0.012, -half, half, 0.003))
    for y in (-0.6, 0.6):
        shell.quads("floor", "joint", _flat(0.0, LENGTH_M, y - 0.012, y + 0.012, 0.003))


def _hang_ceiling(shell: PlacedMeshes, rng: np.random.Generator) -> None:
    half = WIDTH_M / 2.0
    shell.quads("ceiling", "ceiling", _flat(0.0, LENGTH_M, -half, half, HEIGHT_M)[::-1])
    apart = rng.uniform(2.6, 3.2)
    for x in np.arange(rng.uniform(0.8, 1.6), LENGTH_M - 1.0, apart):
        shell.box("ceiling", "lamp", (x, 0.0, HEIGHT_M - 0.03), (1.2, 0.30, 0.06))
    side = rng.choice([-1.0, 1.0])
    shell.box("ceiling", "duct", (LENGTH_M / 2.0, side * (half - 0.16), HEIGHT_M - 0.06),
              (LENGTH_M, 0.20, 0.12))


def _build_side(shell: PlacedMeshes, rng: np.random.Generator, place: str, wall: Wall, rail: bool
                ) -> None:
    """A long wall with doors; between them skirting, perhaps a rail, here and there a board."""
    doors, s = [], rng.uniform(1.6, 3.0)
    while s + _DOOR_M[0] < LENGTH_M - 1.2:
        doors.append(float(s))
        s += _DOOR_M[0] + rng.uniform(1.8, 3.4)
    ends = [0.0, *(at for s in doors for at in (s, s + _DOOR_M[0])), LENGTH_M]
    for number, (s0, s1) in enumerate(pairwise(ends)):
        near = f"{place} {int(s0 // 6.0)}"
        if number % 2:
            _set_door(shell, near, wall, s0, s1)
        else:
            _face(shell, near, wall, s0, s1)
            if rail:
                shell.quads(near, "rail", wall.slab(s0 + 0.12, s1 - 0.12, 0.84, 0.96, 0.05))
            if s1 - s0 > 1.9 and rng.uniform() < 0.55:
                _hang(shell, rng, near, wall, 0.5 * (s0 + s1))


def _face(shell: PlacedMeshes, place: str, wall: Wall, s0: float, s1: float) -> None:
    """A stretch of plain wall."""
    shell.quads(place, "wall low", wall.quad(s0, s1, 0.0, _BAND_M))
    shell.quads(place, "wall", wall.quad(s0, s1, _BAND_M, HEIGHT_M))
    shell.quads(place, "skirting", wall.slab(s0 + 0.08, s1 - 0.08, 0.0, 0.11, 0.018))


def _set_door(shell: PlacedMeshes, place: str, wall: Wall, s0: float, s1: float) -> None:
    top = _DOOR_M[1]
    shell.quads(place, "wall", wall.quad(s0, s1, top, HEIGHT_M))
    shell.quads(place, "frame", wall.recess(s0, s1, 0.0, top, _REVEAL_M))
    shell.quads(place, "door", wall.quad(s0, s1, 0.0, top, -_REVEAL_M))
    for a, b, low, high in ((s0 - 0.07, s0, 0.0, top + 0.07), (s1, s1 + 0.07, 0.0, top + 0.07),
                            (s0, s1, top, top + 0.07)):
        shell.quads(place, "frame", wall.slab(a, b, low, high, 0.025))
    shell.quads(place, "sign", wall.slab(s1 + 0.16, s1 + 0.34, 1.50, 1.62, 0.015))


def _hang(shell: PlacedMeshes, rng: np.random.Generator, place: str, wall: Wall, s: float) -> None:
    """A notice board or a fire extinguisher."""
    if rng.uniform() < 0.6:
        shell.quads(place, "board", wall.slab(s - 0.5, s + 0.5, 1.25, 1.95, 0.025))
    else:
        shell.quads(place, "extinguisher", wall.slab(s - 0.08, s + 0.08, 1.08, 1.50, 0.12))


def _build_end(shell: PlacedMeshes, place: str, wall: Wall) -> None:
    """A wall with a window."""
    s0, s1, z0, z1 = 0.6, WIDTH_M - 0.6, 0.95, 2.15
    _face(shell, place, wall, 0.0, s0)
    _face(shell, place, wall, s1, WIDTH_M)
    shell.quads(place, "wall low", wall.quad(s0, s1, 0.0, z0))
    shell.quads(place, "wall", wall.quad(s0, s1, z1, HEIGHT_M))
    shell.quads(place, "frame", wall.recess(s0, s1, z0, z1, _REVEAL_M))
    shell.quads(place, "pane", wall.quad(s0, s1, z0, z1, -_REVEAL_M))
