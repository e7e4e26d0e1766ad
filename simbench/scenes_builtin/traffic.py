"""What drives, parks and shines in a town: shared by the scenes that are seen from a car."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath, Wander, camera_from_body, pose
from simbench.scene import SceneObject
from simbench.scenes_builtin.cars import SHAPES, CarLook, add_car, draw_look, flap_angles
from simbench.scenes_builtin.gait import Path
from simbench.scenes_builtin.town import LANE_M, ROAD_M, TownPlan
from slam.geometry.arrays import Array

PARKING_M = (LANE_M + ROAD_M) / 2.0    # of a parked car's middle from the middle of the road
_CAMERA_HEIGHT_M = 1.65
_TURN_RADIUS_M = 9.0       # of the middle line

Progress = Callable[[float], float]   # time (s) to arc length (m) along a path
Spot = tuple[tuple[float, float], float]   # (x, y) m and heading (rad) of a parked car


@dataclass(frozen=True, slots=True)
class Driver:
    """A driving car: where it goes, and how its doors flap."""

    name: str
    look: CarLook
    path: Path
    progress: Progress
    flap_hz: Array      # (3,)
    flap_phase: Array   # (3,) rad

    @classmethod
    def draw(cls, rng: np.random.Generator, name: str, look: CarLook, path: Path,
             progress: Progress) -> Driver:
        return cls(name, look, path, progress, rng.uniform(0.25, 0.6, 3),
                   rng.uniform(0.0, 2.0 * np.pi, 3))

    def add_to(self, spec: mujoco.MjSpec, opening: float) -> SceneObject:
        """Its car; `opening`: share of their way by which doors and tailgate open."""
        add_car(spec, self.name, self.look, flaps=opening > 0.0, rolls=True)
        return SceneObject(self.name, rigid=opening == 0.0, category="car")

    def placed(self, time_s: float, opening: float, speed: float) -> dict[str, Array | float]:
        """Pose, wheels and doors at that time; `speed` is a factor of the doors' own."""
        travelled = self.progress(time_s)
        position, heading = self.path(travelled)
        placed: dict[str, Array | float] = {self.name: pose([*position, 0.0], heading)}
        for wheel in range(4):
            placed[f"{self.name} wheel {wheel}"] = travelled / self.look.shape.wheel_radius
        if opening > 0.0:
            turn = 2.0 * np.pi * self.flap_hz * speed * time_s + self.flap_phase
            placed |= flap_angles(self.name, opening * 0.5 * (1.0 - np.cos(turn)))
        return placed


def draw_driver(spec: mujoco.MjSpec, rng: np.random.Generator, number: int, ahead: bool, path: Path,
                progress: Progress) -> Driver:
    """The car of that number; no van drives ahead of the camera, whose view it would take."""
    name = f"car {number}"
    look = draw_look(spec, rng, name, SHAPES[:2] if ahead else SHAPES)
    return Driver.draw(rng, name, look, path, progress)


@dataclass(frozen=True, slots=True)
class Traffic:
    """The camera's car and all others that drive, under one sun.

    opening: share of their way by which doors and tailgates open; speed: a factor of the doors'.
    """

    camera: Callable[[float], Array]     # time (s) to T_world_camera (4, 4)
    drivers: tuple[Driver, ...]
    opening: float
    speed: float

    def add_to(self, spec: mujoco.MjSpec) -> list[SceneObject]:
        """The cars' bodies, whose meshes are there already."""
        return [driver.add_to(spec, self.opening) for driver in self.drivers]

    def placed(self, time_s: float) -> dict[str, Array | float]:
        """Camera, sun and cars at that time."""
        T_world_camera = self.camera(time_s)
        placement: dict[str, Array | float] = {
            "camera": T_world_camera, "sun": _sun_over(T_world_camera)}
        for driver in self.drivers:
            placement |= driver.placed(time_s, self.opening, self.speed)
        return placement


@dataclass(frozen=True, slots=True)
class CarCamera:
    """A camera on a car that is not seen itself, and sways with it."""

    path: Path
    sway: Wander       # m: sideways, up; rad: yaw, pitch, roll

    @classmethod
    def draw(cls, rng: np.random.Generator, path: Path) -> CarCamera:
        return cls(path, Wander.draw(
            rng, [0.05, 0.008, *np.deg2rad([0.35, 0.30, 0.25])], (0.2, 1.2)))

    def __call__(self, travelled_m: float, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        position, heading = self.path(travelled_m)
        side, up, yaw, pitch, roll = self.sway(time_s)
        left = np.array([-np.sin(heading), np.cos(heading)])
        return camera_from_body(pose([*(position + side * left), _CAMERA_HEIGHT_M + up],
                                     heading + yaw, pitch, roll))


def block_loop(plan: TownPlan, outwards_m: float, clockwise: bool) -> ClosedPath:
    """A way round the block, `outwards_m` from the middle of the roads."""
    o = outwards_m
    corners = np.array([[-o, -o], [plan.width_m + o, -o], [plan.width_m + o, plan.height_m + o],
                        [-o, plan.height_m + o]])
    return ClosedPath(corners[::-1] if clockwise else corners, _TURN_RADIUS_M + o)


def park_cars(spec: mujoco.MjSpec, rng: np.random.Generator, spots: Sequence[Spot], count: int
              ) -> list[SceneObject]:
    """Cars at `count` of the spots, about as drivers leave them."""
    objects = []
    for number, spot in enumerate(np.sort(rng.permutation(len(spots))[:count]), start=1):
        (x, y), heading = spots[spot]
        name = f"parked car {number}"
        car = add_car(spec, name, draw_look(spec, rng, name), flaps=False, rolls=False)
        along = rng.uniform(-1.3, 1.3)
        turn = heading + rng.uniform(-0.03, 0.03)
        car.pos = [x + along * np.cos(heading), y + along * np.sin(heading), 0.0]
        car.quat = [np.cos(turn / 2.0), 0.0, 0.0, np.sin(turn / 2.0)]
        objects.append(SceneObject(name, rigid=True, category="car"))
    return objects


def raise_sun(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Sunlight whose shadows are drawn around the camera, so that they are fine where it looks."""
    bearing, height = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(38.0, 60.0))
    direction = -np.array([np.cos(height) * np.cos(bearing), np.cos(height) * np.sin(bearing),
                           np.sin(height)])
    carrier = spec.worldbody.add_body(name="sun", mocap=True)
    carrier.add_light(name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=direction,
                      pos=-40.0 * direction, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
                      diffuse=[0.70, 0.68, 0.63], specular=[0.15, 0.15, 0.15], castshadow=True)


def _sun_over(T_world_camera: Array) -> Array:
    """Where the sun's carrier stands for that camera."""
    return pose([*T_world_camera[:2, 3], 0.0])
