"""Corridor-v0: along a plain corridor of straight edges behind somebody; a trolley comes by.

Hardly any texture: what there is to hold on to are skirting boards, door frames and lamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.meshes import MeshBuilder, visible_geom
from simbench.motion import ClosedPath, Wander, camera_from_body, pose
from simbench.randomise import generator, jittered_rgba, set_texture
from simbench.scene import Dial, Dials, Placement, SceneObject, Staging, register_scene
from simbench.scenes_builtin.corridor_shell import LENGTH_M, WIDTH_M, build_corridor
from simbench.scenes_builtin.gait import Walker
from simbench.scenes_builtin.pace import Pace, kept_between
from simbench.scenes_builtin.people import Figure, add_person, edgeless_materials
from slam.geometry.arrays import Array

_LANE_M = 0.48             # of everybody from the middle: they keep to the right
_TURN_M = 2.2              # from the ends, where they turn round
_STEP_HZ = 1.8             # of whoever carries the camera
_PUSH_M = 0.86             # from hips to the trolley's middle
# Whatever the dials say, people keep these times from the camera: so long ahead at least, and so
# long before they have caught up with it from behind.
_GAPS_S = {"ahead": (3.2, 45.0), "trolley": (22.0, 13.0), "after it": (16.0, 19.0)}
_ROLES = ("trolley", "ahead", "after it")

DIALS = (
    Dial("texture", 0.12, 0.0, 1.0, "contrast of all textures; 0 leaves plain colours"),
    Dial("people", 2.0, 0.0, 3.0, "one comes with a trolley, the next walks ahead of the camera, "
         "the last comes behind the trolley", integer=True),
    Dial("speed", 1.0, 0.0, 3.0, "of the people, as a factor of 0.9 m/s"),
    Dial("camera_speed", 1.0, 0.0, 3.0, "of whoever carries the camera, as a factor of 0.9 m/s"),
    Dial("undetected", 0.0, 0.0, 1.0, "1: two boxes that have no masks are kicked along the walls",
         integer=True),
)


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Build the corridor and let people walk in it."""
    build_corridor(spec, generator(seed, 0))
    _hang_lamp(spec)
    path = ClosedPath([[_TURN_M, -_LANE_M], [LENGTH_M - _TURN_M, -_LANE_M],
                       [LENGTH_M - _TURN_M, _LANE_M], [_TURN_M, _LANE_M]], 0.45, 0.12)
    camera = _Carrier.draw(generator(seed, 1), path, dials["camera_speed"])
    rng, looks = generator(seed, 2), generator(seed, 3)
    count, speed = round(dials["people"]), dials["speed"]
    walkers = [_walker(spec, rng, looks, camera, number, speed) for number in range(1, count + 1)]
    objects = [SceneObject(each.name, rigid=False, category="person") for each in walkers]
    if walkers:
        _add_trolley(spec, generator(seed, 4))
        objects.append(SceneObject("trolley", rigid=True))
    kicked = []
    if dials["undetected"]:
        kicked = [_KickedBox.draw(spec, generator(seed, 5 + number), number, camera, speed)
                  for number in (1, 2)]

    def script(time_s: float) -> Placement:
        T_world_camera = camera(time_s)
        placed: dict[str, Array | float] = {
            "camera": T_world_camera, "light": pose([*T_world_camera[:2, 3], 2.50])}
        for walker in walkers:
            placed |= walker(time_s)
        if walkers:
            at, heading = path(walkers[0].progress(time_s) + _PUSH_M)
            placed["trolley"] = pose([*at, 0.0], heading)
        for box in kicked:
            placed |= box(time_s)
        return placed

    return Staging(script, tuple(objects), edgeless=tuple(
        material for each in walkers for material in edgeless_materials(each.name)))


def _hang_lamp(spec: mujoco.MjSpec) -> None:
    """Light from above whose shadows are drawn around the camera, so that they are fine there."""
    carrier = spec.worldbody.add_body(name="light", mocap=True)
    carrier.add_light(name="ceiling", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
                      dir=[0.0, 0.0, -1.0], mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
                      diffuse=[0.40, 0.40, 0.39], specular=[0.0, 0.0, 0.0], castshadow=True)


@dataclass(frozen=True, slots=True)
class _Carrier:
    """Somebody who is not seen walks along and holds the camera."""

    path: ClosedPath
    pace: Pace
    start_s: float
    height_m: float
    steps: float        # turns: where in a step they are at first
    hand: Wander        # m: forward, sideways, up; rad: yaw, pitch, roll
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, path: ClosedPath, factor: float) -> _Carrier:
        pace = Pace(path, rng.uniform(0.85, 1.0), 0.35)
        start = path.nearest((rng.uniform(3.0, 4.5), -_LANE_M))
        hand = Wander.draw(rng, [0.03, 0.03, 0.02, *np.deg2rad([4.5, 2.5, 1.5])], (0.1, 0.7))
        return cls(path, pace, pace.clock_at(start), rng.uniform(1.40, 1.55), rng.uniform(),
                   hand, factor)

    def clock(self, time_s: float) -> float:
        return self.start_s + self.factor * time_s

    def __call__(self, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        position, heading = self.path(self.pace(self.clock(time_s)))
        t = self.factor * time_s
        forward, side, up, yaw, pitch, roll = self.hand(t)
        step = 2.0 * np.pi * (_STEP_HZ * t + self.steps)
        side += 0.012 * np.sin(step / 2.0)        # from foot to foot
        up += 0.014 * np.cos(step)
        c, s = np.cos(heading), np.sin(heading)
        at = position + forward * np.array([c, s]) + side * np.array([-s, c])
        return camera_from_body(pose([*at, self.height_m + up], heading + yaw,
                                     0.06 + pitch + 0.006 * np.sin(step), roll))


def _walker(spec: mujoco.MjSpec, rng: np.random.Generator, looks: np.random.Generator,
            camera: _Carrier, number: int, speed: float) -> Walker:
    """All go the same way round, keeping right, and so come towards each other in the middle."""
    name, figure = f"person {number}", Figure(float(looks.uniform(1.62, 1.84)))
    add_person(spec, name, figure, looks)
    role = _ROLES[number - 1]
    if role == "ahead":
        gap = rng.uniform(4.2, 5.0)
    else:
        x = rng.uniform(15.5, 17.0) + (5.0 if role == "after it" else 0.0)
        gap = camera.pace.clock_at(camera.path.nearest((x, _LANE_M))) - camera.start_s
    low, caught_up = _GAPS_S[role]
    hesitation = Wander.draw(rng, [0.12], (0.05, 0.25))

    def progress(time_s: float) -> float:
        here = camera.clock(time_s)
        own = camera.start_s + gap + speed * time_s + float(hesitation(speed * time_s)[0])
        return camera.pace(here + kept_between(own - here, low, camera.pace.round_s - caught_up))

    return Walker(name, figure, camera.path, progress, pushes=role == "trolley")


def _add_trolley(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """A cart of two shelves with things on them: origin on the floor, x forward."""
    frame, crates, linen = MeshBuilder(), MeshBuilder(), MeshBuilder()
    long, wide = 0.72, 0.46
    for x in (-1.0, 1.0):
        for y in (-1.0, 1.0):
            frame.box((x * (long / 2 - 0.02), y * (wide / 2 - 0.02), 0.50), (0.035, 0.035, 0.80))
            frame.box((x * (long / 2 - 0.03), y * (wide / 2 - 0.03), 0.05), (0.10, 0.03, 0.10))
    for z in (0.20, 0.58, 0.86):
        frame.box((0.0, 0.0, z), (long, wide, 0.03), scale=1.5)
    frame.box((-long / 2 - 0.06, 0.0, 0.95), (0.035, wide, 0.035))
    for y in (-1.0, 1.0):
        frame.box((-long / 2 - 0.02, y * (wide / 2 - 0.02), 0.95), (0.08, 0.03, 0.03))
    for z, pile in ((0.215, crates), (0.595, linen), (0.875, crates), (0.875, linen)):
        side = -1.0 if z > 0.8 and pile is linen else 1.0
        size = np.array([rng.uniform(0.22, 0.30), rng.uniform(0.28, 0.38), rng.uniform(0.16, 0.24)])
        pile.box((side * 0.16, rng.uniform(-0.03, 0.03), z + size[2] / 2), size, fit=True)
    body = spec.worldbody.add_body(name="trolley")
    for part, builder, material in (("frame", frame, "metal"), ("crates", crates, "crate"),
                                    ("linen", linen, "linen")):
        builder.add_to(spec, f"trolley {part}")
        visible_geom(body, f"trolley {part}", material)
    for name, texture in (("crate", ("parcel", "squares")), ("linen", ("fabric", "rug"))):
        set_texture(spec.material(name), str(rng.choice(texture)))
        spec.material(name).rgba = jittered_rgba(rng, spec.material(name).rgba[:3], 0.15)


@dataclass(frozen=True, slots=True)
class _KickedBox:
    """A box that slides along a wall, comes to rest and is kicked back; it has no mask."""

    name: str
    way_m: Array        # (2, 2): from where to where
    spin_rad: float
    begin: float
    speed: float

    @classmethod
    def draw(cls, spec: mujoco.MjSpec, rng: np.random.Generator, number: int, camera: _Carrier,
             speed: float) -> _KickedBox:
        name = f"kicked box {number}"
        builder = MeshBuilder()
        builder.box((0.0, 0.0, 0.12), (0.24, 0.24, 0.24), fit=True)
        builder.add_to(spec, name)
        visible_geom(spec.worldbody.add_body(name=name), name, "kicked")
        start = camera.path(camera.pace(camera.start_s))[0][0]
        near, side = start + rng.uniform(3.0, 3.6) + 4.0 * (number - 1), (-1.0) ** number
        y = side * (WIDTH_M / 2.0 - 0.20)
        return cls(name, np.array([[near, y], [near + 1.8, y]]), rng.uniform(-0.1, 0.1),
                   rng.uniform(), speed)

    def __call__(self, time_s: float) -> dict[str, Array | float]:
        turns, share = divmod(self.speed * time_s / 4.0 + self.begin, 1.0)
        slid = 1.0 - (1.0 - min(share / 0.5, 1.0)) ** 2      # friction brakes it evenly
        along = 1.0 - slid if int(turns) % 2 else slid
        at = self.way_m[0] + along * (self.way_m[1] - self.way_m[0])
        return {self.name: pose([*at, 0.0], self.spin_rad * along)}


register_scene(
    name="Corridor-v0",
    description="along a plain corridor of straight edges; a trolley is pushed, somebody passes",
    mjcf="corridor.xml", build=build, dials=DIALS,
    width=640, height=480, fps=30.0, frames=300)
