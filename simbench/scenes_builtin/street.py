"""Street-v0: a camera on a car drives round a block among driving, oncoming and parked cars.

The counterpart of the KITTI recordings: 10 frames a second, a wide image, 40 m of depth and more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath, Wander, camera_from_body, pose
from simbench.randomise import generator
from simbench.scene import Dial, Dials, Placement, SceneObject, Staging, register_scene
from simbench.scenes_builtin.cars import (
    SHAPES,
    CarLook,
    add_car,
    add_car_meshes,
    draw_look,
    flap_angles,
)
from simbench.scenes_builtin.town import HEIGHT_M, LANE_M, ROAD_M, WIDTH_M, build_town
from slam.geometry.arrays import Array

_CAMERA_HEIGHT_M = 1.65
_TURN_RADIUS_M = 9.0       # of the middle line
_GAP_M = (8.5, 60.0)       # cars ahead keep this distance from the camera, whatever the dials say
_PARKED = 14
# In this order cars join as `objects` grows.
_ROLES = ("ahead", "oncoming", "turning", "ahead", "oncoming", "oncoming", "oncoming", "ahead",
          "oncoming", "oncoming", "oncoming", "oncoming")

DIALS = (
    Dial("rigidity", 1.0, 0.0, 1.0, "below 1 doors and tailgates of driving cars open and close"),
    Dial("speed", 1.0, 0.0, 3.0, "of the driving cars, as a factor of 6 to 8 m/s"),
    Dial("camera_speed", 1.0, 0.0, 3.0, "of the camera's car, as a factor of 6 to 7.5 m/s"),
    Dial("objects", 7.0, 1.0, float(len(_ROLES)), "number of driving cars",
         integer=True),
)

Progress = Callable[[float], float]   # time (s) to arc length (m) along a path


@dataclass(frozen=True, slots=True)
class _Driver:
    """A driving car: where it goes, and how its doors flap."""

    name: str
    look: CarLook
    path: ClosedPath
    progress: Progress
    flap_hz: Array      # (3,)
    flap_phase: Array   # (3,) rad


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Build the town, park cars in it, and set others going."""
    build_town(spec, generator(seed, 0))
    opening = 1.0 - dials["rigidity"]
    for shape in SHAPES:
        add_car_meshes(spec, shape, flaps=opening > 0.0)
    _raise_sun(spec, generator(seed, 1))
    parked = _park(spec, generator(seed, 2))
    ego = _Ego.draw(generator(seed, 3), dials["camera_speed"])
    drivers = _draw_traffic(spec, generator(seed, 4), ego, round(dials["objects"]), dials["speed"])
    for driver in drivers:
        add_car(spec, driver.name, driver.look, flaps=opening > 0.0, rolls=True)

    def script(time_s: float) -> Placement:
        T_world_camera = ego.camera(time_s)
        placement: dict[str, Array | float] = {
            "camera": T_world_camera, "sun": pose([*T_world_camera[:2, 3], 0.0])}
        for driver in drivers:
            travelled = driver.progress(time_s)
            placement[driver.name] = _on_road(driver.path, travelled)
            for wheel in range(4):
                placement[f"{driver.name} wheel {wheel}"] = travelled \
                    / driver.look.shape.wheel_radius
            if opening > 0.0:
                turn = 2.0 * np.pi * driver.flap_hz * dials["speed"] * time_s + driver.flap_phase
                placement |= flap_angles(driver.name, opening * 0.5 * (1.0 - np.cos(turn)))
        return placement

    objects = [SceneObject(driver.name, rigid=opening == 0.0, category="car") for driver in drivers]
    objects += [SceneObject(name, rigid=True, category="car") for name in parked]
    return Staging(script, tuple(objects), shortest_edge_m=0.25, edgeless=("leaves",))


def _block_loop(outwards_m: float, clockwise: bool) -> ClosedPath:
    """A way round the block, `outwards_m` from the middle of the roads."""
    o = outwards_m
    corners = np.array([[-o, -o], [WIDTH_M + o, -o], [WIDTH_M + o, HEIGHT_M + o],
                        [-o, HEIGHT_M + o]])
    return ClosedPath(corners[::-1] if clockwise else corners, _TURN_RADIUS_M + o)


def _on_road(path: ClosedPath, travelled_m: float) -> Array:
    """T_world_car (4, 4) after that way along the path."""
    position, heading = path(travelled_m)
    return pose([*position, 0.0], heading)


@dataclass(frozen=True, slots=True)
class _Ego:
    """The car that carries the camera: it is not seen, but its camera sways with it."""

    path: ClosedPath
    start_m: float
    speed_m_s: float
    pace: Wander       # m along the way
    sway: Wander       # m: sideways, up; rad: yaw, pitch, roll
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, factor: float) -> _Ego:
        path = _block_loop(LANE_M / 2.0, clockwise=False)
        start = path.nearest((rng.uniform(39.0, 46.0), -LANE_M / 2.0))
        return cls(path, start, rng.uniform(6.0, 7.5), Wander.draw(rng, [0.6], (0.05, 0.15)),
                   Wander.draw(rng, [0.05, 0.008, *np.deg2rad([0.35, 0.30, 0.25])], (0.2, 1.2)),
                   factor)

    def progress(self, time_s: float) -> float:
        t = self.factor * time_s
        return self.start_m + self.speed_m_s * t + float(self.pace(t)[0])

    def camera(self, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        position, heading = self.path(self.progress(time_s))
        side, up, yaw, pitch, roll = self.sway(self.factor * time_s)
        left = np.array([-np.sin(heading), np.cos(heading)])
        return camera_from_body(pose([*(position + side * left), _CAMERA_HEIGHT_M + up],
                                     heading + yaw, pitch, roll))


def _draw_traffic(spec: mujoco.MjSpec, rng: np.random.Generator, ego: _Ego, count: int,
                  speed: float) -> tuple[_Driver, ...]:
    """The driving cars, by their roles."""
    roles = _ROLES[:count]
    oncoming = _block_loop(-LANE_M / 2.0, clockwise=True)
    # The first one comes into sight, 30 m ahead, soon after the start.
    ahead_xy, _ = ego.path(ego.start_m + 30.0)
    first = oncoming.nearest((ahead_xy[0], LANE_M / 2.0)) - rng.uniform(0.0, 12.0)
    oncoming_speed = speed * rng.uniform(6.0, 8.0)
    apart = min(38.0, oncoming.length_m / max(1, roles.count("oncoming")))
    headway, drivers = rng.uniform(10.0, 12.5), []
    for number, role in enumerate(roles, start=1):
        name = f"car {number}"
        path, progress = ego.path, _ahead_of(ego, headway, speed, rng)
        if role == "ahead":
            headway += rng.uniform(11.0, 14.0)
        elif role == "oncoming":
            nth = roles[:number].count("oncoming") - 1
            path = oncoming
            progress = _steady(first - nth * apart, oncoming_speed)
        else:
            path, progress = _turning(rng, speed)
        shapes = SHAPES[:2] if role == "ahead" else SHAPES
        drivers.append(_Driver(name, draw_look(spec, rng, name, shapes), path, progress,
                               rng.uniform(0.25, 0.6, 3), rng.uniform(0.0, 2.0 * np.pi, 3)))
    return tuple(drivers)


def _steady(start_m: float, speed_m_s: float) -> Progress:
    return lambda time_s: start_m + speed_m_s * time_s


def _ahead_of(ego: _Ego, headway_m: float, speed: float, rng: np.random.Generator) -> Progress:
    """In the camera's lane, with a pace of its own, yet never too near nor too far."""
    pace = Wander.draw(rng, [1.0], (0.05, 0.2))
    low, high = headway_m - 10.0 + _GAP_M[0], _GAP_M[1] + headway_m

    def progress(time_s: float) -> float:
        t = speed * time_s
        here = ego.progress(time_s)
        own = ego.start_m + headway_m + ego.speed_m_s * t + float(pace(t)[0])
        gap = low + np.logaddexp(0.0, own - here - low)         # smooth maximum
        return float(here + high - np.logaddexp(0.0, high - gap))

    return progress


def _turning(rng: np.random.Generator, speed: float) -> tuple[ClosedPath, Progress]:
    """Out of the side street in the south, right at the crossing, to a stop in the east."""
    lane, far = LANE_M / 2.0, ROAD_M + 34.0
    x, y = WIDTH_M + lane, -lane
    path = ClosedPath([[x, y - far - 40.0], [x, y], [x + far + 40.0, y],
                       [x + far + 40.0, y - far - 40.0]], 7.0)
    start = path.nearest((x, -rng.uniform(20.0, 26.0)))
    stop = path.nearest((WIDTH_M + far - 7.0, y))
    pace, brake = speed * rng.uniform(5.0, 6.0), 2.0
    way = stop - start

    def progress(time_s: float) -> float:
        braking_m = pace**2 / (2.0 * brake)
        cruise_s = (way - braking_m) / max(pace, 1e-9)
        if time_s <= cruise_s:
            return float(start + pace * time_s)
        late = min(time_s - cruise_s, pace / brake)
        return float(start + way - braking_m + pace * late - 0.5 * brake * late**2)

    return path, progress


def _park(spec: mujoco.MjSpec, rng: np.random.Generator) -> list[str]:
    """Cars along the kerbs of the first two roads that the camera drives, and of the others."""
    strip = (LANE_M + ROAD_M) / 2.0
    roads = [((x, -strip), 0.0) for x in np.arange(14.0, 68.0, 9.0)]
    roads += [((x, strip), np.pi) for x in np.arange(16.0, 68.0, 9.0)]
    roads += [((WIDTH_M + strip, y), np.pi / 2) for y in np.arange(14.0, 52.0, 9.0)]
    roads += [((WIDTH_M - strip, y), -np.pi / 2) for y in np.arange(16.0, 52.0, 9.0)]
    roads += [((x, HEIGHT_M - strip), 0.0) for x in (20.0, 40.0, 60.0)]
    roads += [((-strip, y), np.pi / 2) for y in (20.0, 40.0)]
    names = []
    for number, spot in enumerate(np.sort(rng.permutation(len(roads))[:_PARKED]), start=1):
        (x, y), heading = roads[spot]
        name = f"parked car {number}"
        car = add_car(spec, name, draw_look(spec, rng, name), flaps=False, rolls=False)
        along = rng.uniform(-1.3, 1.3)
        turn = heading + rng.uniform(-0.03, 0.03)
        car.pos = [x + along * np.cos(heading), y + along * np.sin(heading), 0.0]
        car.quat = [np.cos(turn / 2.0), 0.0, 0.0, np.sin(turn / 2.0)]
        names.append(name)
    return names


def _raise_sun(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Sunlight whose shadows are drawn around the camera, so that they are fine where it looks."""
    bearing, height = rng.uniform(0.0, 2.0 * np.pi), np.deg2rad(rng.uniform(38.0, 60.0))
    direction = -np.array([np.cos(height) * np.cos(bearing), np.cos(height) * np.sin(bearing),
                           np.sin(height)])
    carrier = spec.worldbody.add_body(name="sun", mocap=True)
    carrier.add_light(name="sun", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=direction,
                      pos=-40.0 * direction, mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
                      diffuse=[0.70, 0.68, 0.63], specular=[0.15, 0.15, 0.15], castshadow=True)


register_scene(
    name="Street-v0",
    description="a town street with driving, oncoming, turning and parked cars, seen from a car",
    mjcf="street.xml", build=build, dials=DIALS,
    width=1216, height=368, fps=10.0, frames=100)
