"""Office-v0: people walk, sit and push a chair in a desk room, before a camera held by hand.

The counterpart of TUM's freiburg3 walking and sitting sequences, and of an experiment with a static
camera before which somebody enters, turns a chair and leaves.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, bake_static_boxes, visible_geom
from simbench.motion import ClosedPath, Wander, look_at, pose
from simbench.randomise import generator, jittered_rgba, set_texture
from simbench.scene import (
    Dial,
    Dials,
    Placement,
    SceneObject,
    Staging,
    choice_dial,
    register_scene,
)
from simbench.scenes_builtin.chairs import SEAT_M, add_chair, add_chair_meshes
from simbench.scenes_builtin.gait import OpenPath, Sitter, Walker
from simbench.scenes_builtin.people import Figure, add_person, edgeless_materials
from slam.geometry.arrays import Array

PEOPLE = ("walking", "sitting", "none", "visit")
CAMERA_MOTIONS = ("xyz", "static", "rpy", "halfsphere")
DIALS = (
    choice_dial("people", PEOPLE, "walking about and pushing a chair; sitting and gesturing; none; "
                "visit: one comes in, turns a chair that nobody detects, and leaves"),
    choice_dial("camera_motion", CAMERA_MOTIONS, "how the hand moves the camera, as in TUM's "
                "recordings"),
    Dial("speed", 1.0, 0.0, 2.0, "of the people, as a factor of 0.8 to 1.1 m/s"),
    Dial("camera_speed", 1.0, 0.0, 3.0, "camera motion, as a factor of a calm hand's"),
    Dial("undetected", 0.0, 0.0, 1.0, "1: a box that has no mask is kicked to and fro",
         integer=True),
    Dial("limbs", 1.0, 0.0, 1.0, "share of their strides and gestures; 0: people are rigid"),
)

_CAMERA_M = np.array([-2.62, 0.0, 1.42])
_TARGET_M = np.array([1.2, 0.0, 1.12])
_LOOKS = {
    "floor": ("planks", "concrete", "pavers"),
    "wall": ("plaster", "concrete", "siding"),
    "accent wall": ("brick", "blocks", "siding"),
    "panel": ("fabric", "rug"), "rug": ("rug", "fabric"), "carton": ("parcel", "squares"),
}
_POSTERS = ("poster_a", "poster_b", "poster_c", "poster_d")
_TURN_S = (4.2, 6.2)          # when the visitor turns the chair
_VISIT_CHAIR_M = np.array([0.35, 0.62])
# From where to where a box is kicked, clear of whoever is there.
_KICKS_M = {"walking": np.array([[0.0, -1.2], [0.0, 1.2]]),
            "sitting": np.array([[0.0, -1.30], [0.6, -1.85]]),
            "visit": np.array([[0.32, -1.2], [0.32, -0.1]])}

Part = Callable[[float], Placement]


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Furnish the room and let the people in."""
    _furnish(spec, generator(seed, 0))
    add_chair_meshes(spec)
    people = PEOPLE[int(dials["people"])]
    rng, looks = generator(seed, 1), generator(seed, 2)
    make = {"walking": _walking, "sitting": _sitting, "none": _empty, "visit": _visit}[people]
    parts, objects = make(spec, rng, looks, dials["speed"], dials["limbs"])
    if dials["undetected"]:
        parts.append(_kicked_box(spec, generator(seed, 4), dials["speed"],
                                 _KICKS_M.get(people, _KICKS_M["walking"])))
    camera = _camera(CAMERA_MOTIONS[int(dials["camera_motion"])], generator(seed, 3))
    camera_speed = dials["camera_speed"]

    def script(time_s: float) -> Placement:
        placed: dict[str, Array | float] = {"camera": camera(camera_speed * time_s)}
        for part in parts:
            placed |= part(time_s)   # type: ignore[arg-type]
        return placed

    persons = [each.body for each in objects if each.category == "person"]
    return Staging(script, tuple(objects), edgeless=tuple(
        material for name in persons for material in edgeless_materials(name)))


def _furnish(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    for material, textures in _LOOKS.items():
        set_texture(spec.material(material), str(rng.choice(textures)))
    for material, texture in zip("abcd", rng.permutation(_POSTERS), strict=True):
        set_texture(spec.material(f"poster {material}"), str(texture))
    for each in spec.materials:
        each.rgba = jittered_rgba(rng, each.rgba[:3], 0.10)
    for name in ("printer table", "boxes", "plant"):
        body = spec.body(name)
        body.pos = np.asarray(body.pos) + np.array([*rng.uniform(-0.08, 0.08, 2), 0.0])
    bake_static_boxes(spec)
    for name, rgb in (("chair cloth", (0.36, 0.42, 0.56)), ("kicked", (0.82, 0.72, 0.58))):
        material = spec.add_material(name=name, rgba=jittered_rgba(rng, rgb, 0.15), specular=0.0)
        set_texture(material, "fabric" if name == "chair cloth" else "parcel")


def _person(number: int, limbs: float) -> SceneObject:
    return SceneObject(f"person {number}", rigid=limbs == 0.0, category="person")


def _new_person(spec: mujoco.MjSpec, looks: np.random.Generator, number: int) -> tuple[str, Figure]:
    name, figure = f"person {number}", Figure(float(looks.uniform(1.64, 1.84)))
    add_person(spec, name, figure, looks)
    return name, figure


def _walking(spec: mujoco.MjSpec, rng: np.random.Generator, looks: np.random.Generator,
             speed: float, limbs: float) -> tuple[list[Part], list[SceneObject]]:
    """Two go round before the desks, a third pushes a chair to and fro beside them."""
    parts: list[Part] = []
    loop = ClosedPath([[-1.32, -0.74], [-0.46, -0.80], [-0.46, 0.80], [-1.32, 0.74]], 0.46, 0.15)
    start, pace = rng.uniform(0.0, loop.length_m), speed * rng.uniform(0.8, 0.95)
    for number in (1, 2):
        name, figure = _new_person(spec, looks, number)
        begin = start + (number - 1) * loop.length_m / 2.0
        parts.append(Walker(name, figure, loop, lambda t, s=begin: s + pace * t,   # type: ignore[misc]
                            limbs=limbs))
    # The third comes along the far side of the room, behind the desks and back on the left.
    far = ClosedPath([[0.46, -1.85], [2.72, -1.85], [2.72, 1.85], [0.46, 1.85]], 0.5, 0.2)
    name, figure = _new_person(spec, looks, 3)
    add_chair(spec, "chair 1")
    begin, pace_far = rng.uniform(0.0, far.length_m), speed * rng.uniform(0.8, 1.0)
    parts.append(Walker(name, figure, far, lambda t: begin + pace_far * t, pushes=True,
                        limbs=limbs))

    def pushed(time_s: float) -> Placement:
        at, heading = far(begin + pace_far * time_s + 0.72)
        return {"chair 1": pose([*at, 0.0], heading)}

    parts.append(pushed)
    people = [_person(number, limbs) for number in (1, 2, 3)]
    _stand_chair(spec, "chair left", np.array([1.45, 1.42]), -1.75)
    return parts, [*people, SceneObject("chair 1", rigid=True, category="chair")]


def _sitting(spec: mujoco.MjSpec, rng: np.random.Generator, looks: np.random.Generator,
             speed: float, limbs: float) -> tuple[list[Part], list[SceneObject]]:
    """Two sit before the desks and talk with their hands."""
    parts: list[Part] = []
    for number, (y, heading) in enumerate(((-0.62, 2.2), (0.62, -2.5)), start=1):
        name, figure = _new_person(spec, looks, number)
        at = np.array([0.15 + rng.uniform(-0.08, 0.08), y])
        turn = heading + float(rng.uniform(-0.3, 0.3))
        _stand_chair(spec, f"chair {number}", at, turn)
        sitter = Sitter.draw(rng, name, figure, np.array([*at, SEAT_M + 0.10]), turn, limbs)
        parts.append(lambda t, sitter=sitter: sitter(speed * t))   # type: ignore[misc]
    return parts, [_person(number, limbs) for number in (1, 2)]


def _empty(spec: mujoco.MjSpec, rng: np.random.Generator, looks: np.random.Generator,
           speed: float, limbs: float) -> tuple[list[Part], list[SceneObject]]:
    _stand_chair(spec, "chair left", np.array([1.45, 1.42]), -1.75)
    _stand_chair(spec, "chair right", np.array([1.4, -1.40]), 1.45)
    return [], []


def _visit(spec: mujoco.MjSpec, rng: np.random.Generator, looks: np.random.Generator,
           speed: float, limbs: float) -> tuple[list[Part], list[SceneObject]]:
    """Somebody comes in by the door, turns the chair, which has no mask, and goes again."""
    name, figure = _new_person(spec, looks, 1)
    x, y = _VISIT_CHAIR_M
    path = OpenPath(np.array([[-0.35, 4.6], [-0.38, 3.0], [-0.45, 1.9], [-0.42, 1.1], [-0.42, 0.45],
                              [-0.50, -0.4], [-0.55, -1.4], [-0.6, -2.6], [-0.6, -4.0]]))
    walker_step = Walker(name, figure, path, lambda t: 0.0).step_m
    # They stop with both feet on the floor: after a whole number of steps.
    stop = walker_step * round((path.length_m * 0.455) / walker_step)
    _stand_chair(spec, "chair right", np.array([1.4, -1.40]), 1.45)
    walk = Walker(name, figure, path, lambda t: _visit_progress(speed * t, stop, walker_step),
                  limbs=limbs)
    add_chair(spec, "turned chair")
    first = float(rng.uniform(-0.4, 0.4)) + np.pi
    angle = float(rng.choice([-1.0, 1.0]) * rng.uniform(1.3, 2.2))

    def visitor(time_s: float) -> Placement:
        placed: dict[str, Array | float] = walk(time_s)
        share = np.clip((speed * time_s - _TURN_S[0]) / (_TURN_S[1] - _TURN_S[0]), 0.0, 1.0)
        reach = limbs * float(np.sin(np.pi * share)) ** 0.5
        placed[f"{name} left shoulder"] = (1.0 - reach) * float(placed[f"{name} left shoulder"]) \
            - 0.95 * reach
        placed[f"{name} left spread"] = 0.06 + 0.75 * reach
        placed[f"{name} twist"] = float(placed[f"{name} twist"]) + 0.5 * reach
        placed[f"{name} lean"] = 0.05 + 0.25 * reach
        turn = first + angle * share * share * (3.0 - 2.0 * share)
        placed["turned chair"] = pose([x, y, 0.0], float(turn))
        return placed

    return [visitor], [_person(1, limbs)]


def _visit_progress(time_s: float, stop_m: float, step_m: float) -> float:
    """In until `stop_m`, a stand while the chair is turned, and on."""
    pace = 1.0
    arrive, leave = _TURN_S[0] - 0.2, _TURN_S[1] + 0.2
    if time_s <= arrive:
        late = arrive - time_s
        return stop_m - pace * (np.sqrt(late * late + 0.09) - 0.3)
    late = max(time_s - leave, 0.0)
    return stop_m + pace * (np.sqrt(late * late + 0.09) - 0.3)


def _stand_chair(spec: mujoco.MjSpec, name: str, at: Array, turn: float) -> None:
    body = add_chair(spec, name)
    body.pos = [*at, 0.0]
    body.quat = [np.cos(turn / 2.0), 0.0, 0.0, np.sin(turn / 2.0)]


def _kicked_box(spec: mujoco.MjSpec, rng: np.random.Generator, speed: float,
                way_m: Array) -> Part:
    """A box slides over the floor, comes to rest, and is kicked back; it has no mask."""
    builder = MeshBuilder()
    builder.box((0.0, 0.0, 0.14), (0.32, 0.28, 0.28), fit=True)
    builder.add_to(spec, "kicked box")
    visible_geom(spec.worldbody.add_body(name="kicked box"), "kicked box", "kicked")
    period_s = 5.0
    spin = rng.uniform(2.0, 4.0)
    begin = rng.uniform(0.0, 1.0)

    def box(time_s: float) -> Placement:
        turns, share = divmod(speed * time_s / period_s + begin, 1.0)
        slid = 1.0 - (1.0 - min(share / 0.45, 1.0)) ** 2      # friction brakes it evenly
        along = 1.0 - slid if int(turns) % 2 else slid
        return {"kicked box": pose([*(way_m[0] + along * (way_m[1] - way_m[0])), 0.0],
                                   float(spin * along))}

    return box


def _camera(motion: str, rng: np.random.Generator) -> Callable[[float], Array]:
    """T_world_camera of a time, for one of TUM's ways of moving a camera."""
    band = (0.08, 0.55)
    rms = {"xyz": ((0.17, 0.24, 0.14), (0.05, 0.05, 0.04), 1.0),
           "static": ((0.006, 0.008, 0.005), (0.02, 0.02, 0.015), 0.3),
           "rpy": ((0.02, 0.03, 0.02), (0.0, 0.48, 0.42), 8.0),
           "halfsphere": ((0.03, 0.03, 0.03), (0.08, 0.10, 0.08), 2.0)}[motion]
    position, target = Wander.draw(rng, rms[0], band), Wander.draw(rng, rms[1], band)
    roll = Wander.draw(rng, [np.deg2rad(rms[2])], band)
    angle = Wander.draw(rng, np.deg2rad([14.0, 8.0]), (0.06, 0.25))

    def camera(time_s: float) -> Array:
        at, aim = _CAMERA_M + position(time_s), _TARGET_M + target(time_s)
        if motion == "xyz":
            aim = aim + 0.8 * position(time_s)      # it hardly turns
        if motion == "halfsphere":
            # On a sphere about a point before the desks, as far as the wall behind it lets it.
            around, up = angle(time_s)
            centre, distance, height = np.array([0.2, 0.0, 1.0]), 2.75, 0.18 + up
            at = at - _CAMERA_M + centre + distance * np.array(
                [-np.cos(around) * np.cos(height), -np.sin(around) * np.cos(height),
                 np.sin(height)])
            aim = centre + target(time_s)
        at[0] = max(float(at[0]), -3.0)             # the wall is behind
        return look_at(at, aim, float(roll(time_s)[0]))

    return camera


register_scene(
    name="Office-v0",
    description="people walk, sit or push a chair in a desk room; hand-held camera",
    mjcf="office.xml", build=build, dials=DIALS,
    width=640, height=480, fps=30.0, frames=300)
