"""People as jointed bodies of smooth meshes: pelvis, chest, head, arms, legs."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from simbench.randomise import hue_rgba, set_texture
from simbench.scenes_builtin.bodies import add_hinged
from slam.geometry.arrays import Array

_SIDES = 16              # of a limb's cross-section
_SKIN = ((0.95, 0.76, 0.64), (0.80, 0.58, 0.44), (0.55, 0.38, 0.28), (0.90, 0.68, 0.54))
_HAIR = ((0.20, 0.14, 0.10), (0.45, 0.30, 0.16), (0.12, 0.11, 0.12), (0.62, 0.52, 0.36))
_SHIRTS = ("squares", "fabric", "rug", "triangles", "mosaic")
SIDES = {"left": 1.0, "right": -1.0}


@dataclass(frozen=True, slots=True)
class Figure:
    """Lengths (m) of a person of that stature."""

    stature: float = 1.75

    @property
    def scale(self) -> float:
        return self.stature / 1.75

    @property
    def thigh(self) -> float:
        return 0.43 * self.scale

    @property
    def shank(self) -> float:
        return 0.41 * self.scale

    @property
    def ankle(self) -> float:
        """Height of the ankle above the sole."""
        return 0.08 * self.scale

    @property
    def hip(self) -> float:
        """Of a hip sideways from the middle."""
        return 0.09 * self.scale


def add_person(spec: mujoco.MjSpec, name: str, figure: Figure, rng: np.random.Generator,
               parent: mujoco.MjsBody | None = None) -> mujoco.MjsBody:
    """A person, a child of the world or of `parent`: origin between the hips, x forward, z up.

    Hinges are named "<name> lean", "... twist", "... nod", "... look" (chest and head), and for
    each side "... left shoulder", "... left spread", "... left elbow", "... left turn",
    "... left roll", "... left hip", "... left knee", "... left ankle". All stand at 0 in a person
    who stands straight with hanging arms.
    """
    k = figure.scale
    looks = _add_materials(spec, name, rng)
    for part, (builder, _) in _meshes(k).items():
        builder.add_to(spec, f"{name} {part}", smooth=True)
    materials = {part: looks[look] for part, (_, look) in _meshes(k).items()}

    def show(body: mujoco.MjsBody, *parts: str) -> None:
        for part in parts:
            visible_geom(body, f"{name} {part}", materials[part])

    y, x, z = [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    pelvis = (parent or spec.worldbody).add_body(name=name)
    show(pelvis, "pelvis")
    chest = add_hinged(pelvis, f"{name} chest", [0.0, 0.0, 0.08 * k],
                       {f"{name} lean": y, f"{name} twist": z})
    show(chest, "torso", "neck")
    head = add_hinged(chest, f"{name} head", [0.0, 0.0, 0.54 * k],
                      {f"{name} look": z, f"{name} nod": y})
    show(head, "face", "hair", "eyes")
    for side, sign in SIDES.items():
        arm = add_hinged(chest, f"{name} {side} arm", [0.0, sign * 0.2 * k, 0.415 * k],
                         {f"{name} {side} shoulder": y, f"{name} {side} spread": x})
        show(arm, "upper arm")
        forearm = add_hinged(arm, f"{name} {side} forearm", [0.0, 0.0, -0.29 * k],
                             {f"{name} {side} elbow": y})
        show(forearm, "forearm", "hand")
        thigh = add_hinged(pelvis, f"{name} {side} thigh", [0.0, sign * figure.hip, 0.0],
                           {f"{name} {side} turn": z, f"{name} {side} roll": x,
                            f"{name} {side} hip": y})
        show(thigh, "thigh")
        shank = add_hinged(thigh, f"{name} {side} shank", [0.0, 0.0, -figure.thigh],
                           {f"{name} {side} knee": y})
        show(shank, "shank")
        foot = add_hinged(shank, f"{name} {side} foot", [0.0, 0.0, -figure.shank],
                          {f"{name} {side} ankle": y})
        show(foot, "shoe")
    return pelvis


def edgeless_materials(name: str) -> tuple[str, ...]:
    """What a person is made of has no straight edges."""
    return tuple(f"{name} {look}" for look in ("skin", "hair", "shirt", "trousers", "shoe"))


def _add_materials(spec: mujoco.MjSpec, name: str, rng: np.random.Generator) -> dict[str, str]:
    colours = {
        "skin": ([*_SKIN[int(rng.integers(len(_SKIN)))], 1.0], "plaster"),
        "hair": ([*_HAIR[int(rng.integers(len(_HAIR)))], 1.0], "fabric"),
        "shirt": (hue_rgba(rng.uniform(), rng.uniform(0.35, 0.75), rng.uniform(0.7, 1.0)),
                  str(rng.choice(_SHIRTS))),
        "trousers": (hue_rgba(rng.uniform(0.55, 0.7), rng.uniform(0.2, 0.5),
                              rng.uniform(0.35, 0.65)), "fabric"),
        "shoe": ([0.25, 0.22, 0.22, 1.0], "fabric"),
    }
    for look, (rgba, texture) in colours.items():
        set_texture(spec.add_material(name=f"{name} {look}", rgba=rgba, specular=0.0), texture)
    return {look: f"{name} {look}" for look in colours}


def _meshes(k: float) -> dict[str, tuple[MeshBuilder, str]]:
    """Mesh and look of each part; rings are (z, half depth, half width, forward) in units of k."""
    eyes = MeshBuilder()
    for sign in (-1.0, 1.0):
        eyes.box((0.098 * k, sign * 0.034 * k, 0.13 * k), (0.012 * k, 0.028 * k, 0.014 * k))
    face = _tube(k, [(0.0, 0.05, 0.045, 0.02), (0.02, 0.075, 0.06, 0.015),
                     (0.06, 0.092, 0.07, 0.012),
                     (0.12, 0.098, 0.076, 0.004), (0.17, 0.096, 0.074, 0.0),
                    (0.21, 0.07, 0.055, -0.005), (0.225, 0.02, 0.02, -0.01)])
    face.box((0.112 * k, 0.0, 0.095 * k), (0.035 * k, 0.026 * k, 0.045 * k))
    hair = _tube(k, [(0.09, 0.088, 0.083, -0.028), (0.14, 0.096, 0.086, -0.022),
                    (0.175, 0.106, 0.086, -0.008), (0.215, 0.085, 0.068, -0.008),
                    (0.24, 0.03, 0.03, -0.01)])
    return {
        "pelvis": (_tube(k, [(-0.11, 0.07, 0.10, 0.0), (-0.06, 0.112, 0.165, 0.0),
                            (0.02, 0.115, 0.17, 0.0), (0.09, 0.10, 0.15, 0.0)]), "trousers"),
        "torso": (_tube(k, [(-0.04, 0.115, 0.168, 0.0), (0.02, 0.112, 0.16, 0.0),
                           (0.16, 0.115, 0.165, 0.005), (0.30, 0.12, 0.19, 0.01),
                           (0.40, 0.105, 0.20, 0.005), (0.45, 0.08, 0.175, 0.0),
                           (0.485, 0.05, 0.08, 0.0)]), "shirt"),
        "neck": (_tube(k, [(0.45, 0.052, 0.055, 0.0), (0.59, 0.048, 0.05, 0.015)]), "skin"),
        "face": (face, "skin"), "hair": (hair, "hair"), "eyes": (eyes, "shoe"),
        "upper arm": (_tube(k, [(-0.30, 0.042, 0.04, 0.0), (-0.15, 0.05, 0.048, 0.0),
                               (-0.03, 0.056, 0.055, 0.0), (0.015, 0.05, 0.048, 0.0),
                               (0.032, 0.03, 0.028, 0.0)]), "shirt"),
        "forearm": (_tube(k, [(-0.25, 0.029, 0.026, 0.0), (-0.10, 0.04, 0.038, 0.0),
                             (0.0, 0.042, 0.04, 0.0), (0.035, 0.025, 0.025, 0.0)]), "shirt"),
        "hand": (_tube(k, [(-0.43, 0.018, 0.01, 0.01), (-0.38, 0.038, 0.015, 0.008),
                          (-0.30, 0.042, 0.02, 0.005), (-0.24, 0.026, 0.022, 0.0)]), "skin"),
        "thigh": (_tube(k, [(-0.45, 0.056, 0.055, 0.0), (-0.30, 0.07, 0.068, 0.0),
                           (-0.10, 0.088, 0.084, 0.0), (0.0, 0.09, 0.085, 0.0),
                           (0.06, 0.05, 0.05, 0.0)]), "trousers"),
        "shank": (_tube(k, [(-0.40, 0.048, 0.046, 0.0), (-0.15, 0.058, 0.055, -0.008),
                           (0.0, 0.057, 0.056, 0.0), (0.04, 0.035, 0.035, 0.0)]), "trousers"),
        "shoe": (_shoe(k), "shoe"),
    }


def _tube(k: float, rings: list[tuple[float, float, float, float]]) -> MeshBuilder:
    """A closed tube about the z axis through ellipses."""
    z, depth, width, forward = k * np.array(rings).T
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES + 1)
    ring = np.stack([forward[:, None] + depth[:, None] * np.cos(angle),
                     width[:, None] * np.sin(angle),
                     np.broadcast_to(z[:, None], (len(z), _SIDES + 1))], axis=-1)
    uv = np.stack(np.broadcast_arrays(3.0 * angle / (2.0 * np.pi), 2.4 * z[:, None]), axis=-1)
    builder = MeshBuilder()
    quads, quads_uv = (
        np.stack([each[:-1, :-1], each[:-1, 1:], each[1:, 1:], each[1:, :-1]], axis=2)
        .reshape(-1, 4, each.shape[-1]) for each in (ring, uv))
    builder.quads(quads, quads_uv)
    for end, flip in ((0, True), (-1, False)):
        edge = ring[end][::-1] if flip else ring[end]
        middle = np.broadcast_to(edge[:-1].mean(axis=0), edge[:-1].shape)
        builder.quads(np.stack([middle, edge[:-1], edge[1:], edge[1:]], axis=1))
    return builder


def _shoe(k: float) -> MeshBuilder:
    """A shoe about the ankle, its sole below it: a tube along x, flat below."""
    rings: Array = k * np.array([(-0.065, 0.028, 0.05), (-0.04, 0.038, 0.10), (0.03, 0.04, 0.09),
                                 (0.10, 0.046, 0.055), (0.17, 0.042, 0.035), (0.195, 0.02, 0.02)])
    # The cross-section: sole corners, sides and the round top, seen from the front.
    across = np.array([-0.9, 0.9, 1.0, 0.7, 0.0, -0.7, -1.0, -0.9])
    up = np.array([0.0, 0.0, 0.35, 0.85, 1.0, 0.85, 0.35, 0.0])
    x, width, height = (rings[:, c, None] for c in range(3))
    ring = np.stack([np.broadcast_to(x, (len(rings), len(up))), width * across,
                     height * up - 0.08 * k], axis=-1)
    builder = MeshBuilder()
    builder.quads(np.stack([ring[:-1, :-1], ring[1:, :-1], ring[1:, 1:], ring[:-1, 1:]], axis=2)
                  .reshape(-1, 4, 3)[:, ::-1], scale=3.0)
    for end, flip in ((0, False), (-1, True)):
        edge = ring[end][::-1] if flip else ring[end]
        middle = np.broadcast_to(edge[:-1].mean(axis=0), edge[:-1].shape)
        builder.quads(np.stack([middle, edge[:-1], edge[1:], edge[1:]], axis=1)[:, ::-1], scale=3.0)
    return builder
