"""Office chairs on castors."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from slam.geometry.arrays import Array

SEAT_M = 0.47            # height of the seat


def add_chair_meshes(spec: mujoco.MjSpec) -> None:
    """Put the meshes that all chairs share into `spec`."""
    cloth, frame = MeshBuilder(), MeshBuilder()
    cloth.box((0.0, 0.0, SEAT_M - 0.03), (0.46, 0.46, 0.07), scale=1.6)
    cloth.box((-0.24, 0.0, 0.80), (0.06, 0.42, 0.46), scale=1.6)
    frame.box((-0.25, 0.0, 0.52), (0.04, 0.06, 0.24), scale=2.0)
    frame.box((0.0, 0.0, 0.26), (0.06, 0.06, 0.30), scale=2.0)
    for sign in (-1.0, 1.0):
        frame.box((0.02, sign * 0.26, 0.65), (0.26, 0.05, 0.03), scale=2.0)
        frame.box((-0.06, sign * 0.26, 0.54), (0.04, 0.03, 0.20), scale=2.0)
    for number in range(5):
        angle = 2.0 * np.pi * number / 5.0
        c, s = np.cos(angle), np.sin(angle)
        turn: Array = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        frame.box(turn @ [0.16, 0.0, 0.09], (0.28, 0.05, 0.04), turn, scale=2.0)
        frame.box(turn @ [0.28, 0.0, 0.035], (0.06, 0.04, 0.07), turn, scale=2.0)
    cloth.add_to(spec, "chair cloth")
    frame.add_to(spec, "chair frame")


def add_chair(spec: mujoco.MjSpec, name: str) -> mujoco.MjsBody:
    """A chair as a child of the world: origin on the floor, whoever sits looks along x."""
    body = spec.worldbody.add_body(name=name)
    visible_geom(body, "chair cloth", "chair cloth")
    visible_geom(body, "chair frame", "metal")
    return body
