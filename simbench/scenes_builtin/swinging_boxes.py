"""SwingingBoxes-v0: boxes swing and spin on strings in a furnished room, seen by a hand camera.

The counterpart of "swinging 4" of the Oxford Multimotion Dataset.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, bake_static_boxes, visible_geom
from simbench.motion import Wander, look_at
from simbench.randomise import generator, hue_rgba, jittered_rgba, set_texture
from simbench.scene import Dial, Dials, Placement, SceneObject, Staging, register_scene
from slam.geometry import se3
from slam.geometry.arrays import Array

_CEILING_M = 2.8
_GRAVITY_M_S2 = 9.81
_CAMERA_M = np.array([-2.7, 0.0, 1.45])      # where the hand holds it, on average
_TARGET_M = np.array([0.4, 0.0, 1.36])       # what it looks at, on average
_FLAP_SHARE = 0.28                           # of a box's length, at both ends
_FLAP_OPEN_RAD = np.deg2rad(40.0)            # at rigidity 0
_BOX_TEXTURES = ("triangles", "squares", "stars", "parcel", "mosaic")
_LOOKS = {   # material: the textures that a seed may give it
    "floor": ("planks", "pavers", "planks"),
    "wall": ("plaster", "blocks", "siding", "concrete"),
    "accent wall": ("brick", "blocks", "siding"),
    "rug": ("rug", "fabric", "mosaic"),
    "cushion": ("fabric", "rug"),
    "carton": ("parcel", "squares"),
}
_POSTERS = ("poster_a", "poster_b", "poster_c", "poster_d")
_MOVABLE = ("chair a", "chair b", "low table", "crates")

_MOST_BOXES = 20

DIALS = (
    Dial("rigidity", 1.0, 0.0, 1.0, "below 1 the ends of every box are flaps that open and close"),
    Dial("speed", 1.0, 0.0, 4.0, "swinging and spinning, as a factor of the natural speed"),
    Dial("camera_speed", 1.0, 0.0, 4.0, "camera motion, as a factor of a calm hand's"),
    Dial("objects", 4.0, 1.0, float(_MOST_BOXES), "number of boxes; more are smaller",
         integer=True),
)


@dataclass(frozen=True, slots=True)
class _Box:
    name: str
    half_size: Array        # (3,) m
    centre: Array           # (3,) m, at rest
    string_m: float         # from the pivot to the centre
    quat_wxyz: Array        # (4,) at time 0, about the pivot
    rate_rad_s: Array       # (3,) at time 0, in the box's frame
    flap_hz: Array          # (2,)
    flap_phase: Array       # (2,) rad


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Furnish the room and hang the boxes."""
    _furnish(spec, generator(seed, 0))
    count, speed = round(dials["objects"]), dials["speed"]
    boxes = _draw_boxes(generator(seed, 1), count)
    # Faster swinging is heavier gravity and faster starts: the same path in less time.
    spec.option.gravity = [0.0, 0.0, -_GRAVITY_M_S2 * speed**2]
    flaps = dials["rigidity"] < 1.0
    looks = generator(seed, 2)
    hues = looks.uniform() + looks.permutation(count) / count
    qpos, qvel = [], []
    for box, hue in zip(boxes, hues, strict=True):
        _hang(spec, box, looks, float(hue), flaps)
        qpos += [*box.quat_wxyz, *([0.0, 0.0] if flaps else [])]
        qvel += [*(speed * box.rate_rad_s), *([0.0, 0.0] if flaps else [])]
    spec.add_key(name="start", qpos=qpos, qvel=qvel)
    hand = _Hand.draw(generator(seed, 3))
    opening = _FLAP_OPEN_RAD * (1.0 - dials["rigidity"])
    camera_speed = dials["camera_speed"]

    def script(time_s: float) -> Placement:
        placement: dict[str, Array | float] = {"camera": hand.pose(camera_speed * time_s)}
        if flaps:
            for box in boxes:
                turn = 2.0 * np.pi * box.flap_hz * speed * time_s + box.flap_phase
                angle = opening * 0.5 * (1.0 - np.cos(turn))
                placement[f"{box.name} front flap"] = float(angle[0])
                placement[f"{box.name} back flap"] = float(angle[1])
        return placement

    return Staging(script, tuple(SceneObject(box.name, rigid=not flaps) for box in boxes))


@dataclass(frozen=True, slots=True)
class _Hand:
    """A camera held by hand: it strays, looks about, and rolls."""

    position: Wander
    target: Wander
    roll: Wander

    @classmethod
    def draw(cls, rng: np.random.Generator) -> _Hand:
        band = (0.08, 0.6)
        return cls(Wander.draw(rng, (0.14, 0.26, 0.11), band),
                   Wander.draw(rng, (0.12, 0.20, 0.12), band),
                   Wander.draw(rng, (np.deg2rad(3.5),), band))

    def pose(self, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        return look_at(_CAMERA_M + self.position(time_s), _TARGET_M + self.target(time_s),
                       float(self.roll(time_s)[0]))


def _furnish(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Textures, tints and places of the furniture."""
    for material, textures in _LOOKS.items():
        set_texture(spec.material(material), str(rng.choice(textures)))
    for material, texture in zip("abcd", rng.permutation(_POSTERS), strict=True):
        set_texture(spec.material(f"poster {material}"), str(texture))
    for each in spec.materials:
        each.rgba = jittered_rgba(rng, each.rgba[:3], 0.10)
    for name in _MOVABLE:
        body = spec.body(name)
        body.pos = np.asarray(body.pos) + np.array([*rng.uniform(-0.12, 0.12, 2), 0.0])
        turn_deg = np.array([0.0, 0.0, rng.uniform(-15.0, 15.0)])
        body.alt.euler = np.asarray(body.alt.euler) + turn_deg
    bake_static_boxes(spec)


def _draw_boxes(rng: np.random.Generator, count: int) -> tuple[_Box, ...]:
    places, spacing = _spread(rng, count)
    largest = min(0.235, 0.17 * spacing)     # half an edge
    boxes = []
    for number, (x, y) in enumerate(places, start=1):
        half_size = largest * rng.uniform([0.85, 0.72, 0.72], [1.0, 1.0, 1.0])
        height = rng.uniform(1.22, 1.52)
        string = _CEILING_M - height
        swing = min(0.36, spacing / 2.0 - float(np.linalg.norm(half_size)) - 0.02)
        tilt, pace = float(np.arcsin(swing / string)), np.sqrt(_GRAVITY_M_S2 / string)
        # Energy for a swing of `tilt`, part of it height, part of it speed: an ellipse.
        share, heading = rng.uniform(0.15, 1.4), rng.uniform(0.0, 2.0 * np.pi)
        across = heading + rng.choice([-1.0, 1.0]) * rng.uniform(0.6, 1.5)
        yaw = rng.uniform(0.0, 2.0 * np.pi)
        R_tilt = se3.exp_so3(tilt * np.cos(share) * _direction(heading))
        R = R_tilt @ se3.exp_so3(np.array([0.0, 0.0, yaw]))
        spin = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.3)
        rate_world = tilt * np.sin(share) * pace * _direction(across)
        boxes.append(_Box(
            f"box {number}", half_size, np.array([x, y, height]), string,
            np.roll(se3.quaternion_from_rotation(R), 1),
            R.T @ rate_world + np.array([0.0, 0.0, spin]),
            rng.uniform(0.35, 0.9, 2), rng.uniform(0.0, 2.0 * np.pi, 2)))
    return tuple(boxes)


def _direction(heading: float) -> Array:
    return np.array([np.cos(heading), np.sin(heading), 0.0])


def _spread(rng: np.random.Generator, count: int) -> tuple[Array, float]:
    """Places (count, 2) in the camera's view and their smallest distance (m)."""
    places = _zigzag(rng, count) if count <= 5 else _pushed_apart(rng, count)
    gap = np.linalg.norm(places[:, None] - places[None, :], axis=-1) + np.eye(count) * 1e9
    return places, float(min(gap.min(), 1.5))


def _zigzag(rng: np.random.Generator, count: int) -> Array:
    """Few boxes side by side as the camera sees them, in turn near and far."""
    slope = (np.arange(count) - (count - 1) / 2.0) * min(0.25, 0.75 / max(count - 1, 1))
    is_far = (np.arange(count) + rng.integers(2)) % 2
    depth = np.where(is_far, 3.55, 2.35) + rng.uniform(-0.12, 0.12, count)
    slope = slope + rng.uniform(-0.02, 0.02, count)
    return _CAMERA_M[:2] + np.stack([depth, slope * depth], axis=-1)


def _pushed_apart(rng: np.random.Generator, count: int) -> Array:
    """Many boxes anywhere in view, driven apart as by springs."""
    near, far, slope = 2.1, 4.1, 0.42

    def inside(points: Array) -> Array:
        depth = np.clip(points[:, 0], near, far)
        half_width = slope * depth - 0.1
        return np.stack([depth, np.clip(points[:, 1], -half_width, half_width)], axis=-1)

    points = inside(rng.uniform([near, -1.6], [far, 1.6], size=(count, 2)))
    for step in range(400):
        gap = points[:, None] - points[None, :]
        distance = np.linalg.norm(gap, axis=-1) + np.eye(count) * 1e9
        push = np.sum(gap / distance[..., None] ** 4, axis=1)
        length = np.linalg.norm(push, axis=1, keepdims=True)
        points = inside(points + 0.04 * (1.0 - step / 400.0) * push / np.maximum(length, 1e-9))
    return np.asarray(points + _CAMERA_M[:2])


def _hang(spec: mujoco.MjSpec, box: _Box, rng: np.random.Generator, hue: float,
          flaps: bool) -> None:
    """One pendulum: a ball joint at the ceiling, a string, a box, perhaps with flaps."""
    material = spec.add_material(name=box.name, specular=0.0,
                                 rgba=hue_rgba(hue, 0.86, rng.uniform(0.92, 1.0)))
    set_texture(material, str(rng.choice(_BOX_TEXTURES)))
    scale, shift = rng.uniform(1.6, 2.6), rng.uniform(size=2)
    body = spec.worldbody.add_body(name=box.name, pos=box.centre)
    body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, pos=[0.0, 0.0, box.string_m])
    _weigh(body, 1.0, (np.sum(box.half_size**2) - box.half_size**2) / 3.0)
    length, top = box.half_size[0], box.half_size[2]
    rope = box.string_m - top
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.0035, 0.0035, rope / 2.0],
                  pos=[0.0, 0.0, top + rope / 2.0], material="dark wood", mass=0.0,
                  contype=0, conaffinity=0)
    cut = length * (1.0 - 2.0 * _FLAP_SHARE) if flaps else length
    _piece(spec, body, box, (-cut, cut), scale, shift, "body")
    if flaps:
        _flap(spec, body, box, (cut, length), scale, shift, "front flap")
        _flap(spec, body, box, (-length, -cut), scale, shift, "back flap")


def _flap(spec: mujoco.MjSpec, parent: mujoco.MjsBody, box: _Box, span: tuple[float, float],
          scale: float, shift: Array, name: str) -> None:
    """An end of the box on an upright hinge at one of its corners, opening outwards."""
    flap = parent.add_body(name=f"{box.name} {name}")
    front = span[0] > 0.0
    hinge = [span[0], -box.half_size[1], 0.0] if front else [span[1], box.half_size[1], 0.0]
    flap.add_joint(name=f"{box.name} {name}", type=mujoco.mjtJoint.mjJNT_HINGE, pos=hinge,
                   axis=[0.0, 0.0, -1.0])
    # Next to no mass: a script turns it, and the pendulum is to swing as it does without flaps.
    _weigh(flap, 1e-5, np.full(3, 1e-7))
    _piece(spec, flap, box, span, scale, shift, name)


def _weigh(body: mujoco.MjsBody, mass: float, inertia: Array) -> None:
    """Mass (kg) and principal inertia (3,) about the body's origin."""
    body.explicitinertial, body.mass, body.inertia = True, mass, inertia
    body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]


def _piece(spec: mujoco.MjSpec, body: mujoco.MjsBody, box: _Box, span: tuple[float, float],
           scale: float, shift: Array, name: str) -> None:
    """The stretch of the box from x = span[0] to span[1]; the texture runs on over the cuts."""
    builder, mesh = MeshBuilder(), f"{box.name} {name}"
    centre = [(span[0] + span[1]) / 2.0, 0.0, 0.0]
    size = [span[1] - span[0], 2.0 * box.half_size[1], 2.0 * box.half_size[2]]
    builder.placed_box(centre, size, scale, shift)
    builder.add_to(spec, mesh)
    visible_geom(body, mesh, box.name)


register_scene(
    name="SwingingBoxes-v0",
    description="textured boxes swing and spin on strings in a furnished room; hand-held camera",
    mjcf="swinging_boxes.xml", build=build, dials=DIALS,
    width=640, height=480, fps=30.0, frames=300, most_objects=_MOST_BOXES)
