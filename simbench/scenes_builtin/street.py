"""Street-v0: a camera on a car drives round a block among driving, oncoming and parked cars.

The counterpart of the KITTI recordings: 10 frames a second, a wide image, 40 m of depth and more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath, Wander
from simbench.randomise import generator
from simbench.scene import Dial, Dials, Placement, Staging, choice_dial, register_scene
from simbench.scenes_builtin.cars import add_all_car_meshes
from simbench.scenes_builtin.cyclists import BESIDE_LANE_M, Cyclist
from simbench.scenes_builtin.houses import TownMeshes
from simbench.scenes_builtin.pace import StopAndGo
from simbench.scenes_builtin.town import (
    LANE_M,
    ROAD_M,
    SURROUNDINGS,
    TownPlan,
    build_town,
    choose_facades,
)
from simbench.scenes_builtin.traffic import (
    PARKING_M,
    CarCamera,
    Driver,
    Progress,
    Spot,
    Traffic,
    block_loop,
    draw_driver,
    park_cars,
    raise_sun,
)
from slam.geometry.arrays import Array

ROUTES = ("turning", "straight")
TRAFFIC = ("flowing", "stopped")
_WIDTHS_M = {"turning": 80.0, "straight": 150.0}
_HEIGHT_M = 64.0
_START_M = {"turning": (39.0, 46.0), "straight": (18.0, 25.0)}   # the camera's x at first
_STOP_PERIOD_S = 12.0      # from one standstill of stopped traffic to the next
_GAP_M = (8.5, 60.0)       # cars ahead keep this distance from the camera, whatever the dials say
_PARKED = 14               # a block of 80 m
_CYCLISTS = 3
# In this order cars join as `objects` grows.
_ROLES = ("ahead", "oncoming", "turning", "ahead", "oncoming", "oncoming", "oncoming", "ahead",
          "oncoming", "oncoming", "oncoming", "oncoming")

DIALS = (
    Dial("rigidity", 1.0, 0.0, 1.0, "below 1 doors and tailgates of driving cars open and close"),
    Dial("speed", 1.0, 0.0, 3.0, "of the driving cars, as a factor of 6 to 8 m/s"),
    Dial("camera_speed", 1.0, 0.0, 3.0, "of the camera's car, as a factor of 6 to 7.5 m/s"),
    Dial("objects", 7.0, 0.0, float(len(_ROLES)), "number of driving cars", integer=True),
    choice_dial("surroundings", SURROUNDINGS, "beside the road: houses, open fields or tall trees"),
    choice_dial("route", ROUTES, "round a corner after some seconds, or straight on"),
    choice_dial("traffic", TRAFFIC, "stopped: camera and cars come to a stand and start again"),
    Dial("cyclists", 0.0, 0.0, float(_CYCLISTS), "number of people on bicycles, who pedal",
         integer=True),
    Dial("limbs", 1.0, 0.0, 1.0, "share of their usual way that cyclists' feet go round; below 1 "
         "their wheels slide, at 0 they are rigid"),
)

Clock = Callable[[float], float]      # time (s) to the time that has flowed for the traffic


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Build the town, park cars in it, and set others going."""
    looks = generator(seed, 0)
    choose_facades(spec, looks)
    route = ROUTES[int(dials["route"])]
    plan = TownPlan(_WIDTHS_M[route], _HEIGHT_M, SURROUNDINGS[int(dials["surroundings"])])
    build_town(spec, looks, plan, TownMeshes())
    opening, speed = 1.0 - dials["rigidity"], dials["speed"]
    add_all_car_meshes(spec, flaps=opening > 0.0)
    raise_sun(spec, generator(seed, 1))
    parked = park_cars(spec, generator(seed, 2), _parking_spots(plan),
                       _parked_on(route))
    clock = _flowing if TRAFFIC[int(dials["traffic"])] == "flowing" else StopAndGo(
        _STOP_PERIOD_S, float(generator(seed, 6).uniform(0.0, 2.0)))
    ego = _Ego.draw(generator(seed, 3), plan, _START_M[route], clock, dials["camera_speed"])
    drivers = _draw_traffic(spec, generator(seed, 4), plan, ego, round(dials["objects"]), speed)
    traffic = Traffic(ego.camera, drivers, opening, speed)
    driving = traffic.add_to(spec)
    cyclists = _draw_cyclists(spec, generator(seed, 5), plan, ego, dials)

    def script(time_s: float) -> Placement:
        placement = traffic.placed(time_s)
        for cyclist in cyclists:
            placement |= cyclist.placed(time_s)
        return placement

    return Staging(script, (*driving, *parked, *(each.object for each in cyclists)),
                   shortest_edge_m=0.25, edgeless=("leaves", *(
                       material for each in cyclists for material in each.edgeless)))


def _parked_on(route: str) -> int:
    return round(_PARKED * _WIDTHS_M[route] / _WIDTHS_M["turning"])


def _flowing(time_s: float) -> float:
    return time_s


@dataclass(frozen=True, slots=True)
class _Ego:
    """The car that carries the camera: it is not seen, but its camera sways with it."""

    path: ClosedPath
    start_m: float
    speed_m_s: float
    pace: Wander       # m along the way
    eye: CarCamera
    clock: Clock
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, plan: TownPlan, start_m: tuple[float, float],
             clock: Clock, factor: float) -> _Ego:
        path = block_loop(plan, LANE_M / 2.0, clockwise=False)
        start = path.nearest((rng.uniform(*start_m), -LANE_M / 2.0))
        return cls(path, start, rng.uniform(6.0, 7.5), Wander.draw(rng, [0.6], (0.05, 0.15)),
                   CarCamera.draw(rng, path), clock, factor)

    def progress(self, time_s: float) -> float:
        t = self.factor * self.clock(time_s)
        return self.start_m + self.speed_m_s * t + float(self.pace(t)[0])

    def camera(self, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        return self.eye(self.progress(time_s), self.factor * self.clock(time_s))


def _draw_traffic(spec: mujoco.MjSpec, rng: np.random.Generator, plan: TownPlan, ego: _Ego,
                  count: int, speed: float) -> tuple[Driver, ...]:
    """The driving cars, by their roles."""
    roles = _ROLES[:count]
    oncoming = block_loop(plan, -LANE_M / 2.0, clockwise=True)
    # The first one comes into sight, 30 m ahead, soon after the start.
    ahead_xy, _ = ego.path(ego.start_m + 30.0)
    first = oncoming.nearest((ahead_xy[0], LANE_M / 2.0)) - rng.uniform(0.0, 12.0)
    oncoming_speed = speed * rng.uniform(6.0, 8.0)
    apart = min(38.0, oncoming.length_m / max(1, roles.count("oncoming")))
    headway, drivers = rng.uniform(10.0, 12.5), []
    for number, role in enumerate(roles, start=1):
        path, progress = ego.path, _ahead_of(ego, headway, speed, rng)
        if role == "ahead":
            headway += rng.uniform(11.0, 14.0)
        elif role == "oncoming":
            nth = roles[:number].count("oncoming") - 1
            path = oncoming
            progress = _steady(first - nth * apart, oncoming_speed, ego.clock)
        else:
            path, progress = _turning(rng, plan, speed)
        drivers.append(draw_driver(spec, rng, number, role == "ahead", path, progress))
    return tuple(drivers)


def _draw_cyclists(spec: mujoco.MjSpec, rng: np.random.Generator, plan: TownPlan, ego: _Ego,
                   dials: Dials) -> list[Cyclist]:
    """One whom the camera overtakes, one who comes towards it, one far ahead; none stops."""
    along = block_loop(plan, BESIDE_LANE_M, clockwise=False)
    against = block_loop(plan, -BESIDE_LANE_M, clockwise=True)
    pace = {along: rng.uniform(4.4, 5.2), against: rng.uniform(4.4, 5.2)}
    cyclists = []
    for number, (path, ahead_m) in enumerate(((along, 11.0), (against, 36.0), (along, 24.0))):
        if number < round(dials["cyclists"]):
            start = path.nearest(ego.path(ego.start_m + ahead_m + rng.uniform(-2.0, 2.0))[0])
            cyclists.append(Cyclist.add_to(
                spec, rng, f"cyclist {number + 1}", path,
                _steady(start, dials["speed"] * pace[path], _flowing), dials["limbs"]))
    return cyclists


def _steady(start_m: float, speed_m_s: float, clock: Clock) -> Progress:
    return lambda time_s: start_m + speed_m_s * clock(time_s)


def _ahead_of(ego: _Ego, headway_m: float, speed: float, rng: np.random.Generator) -> Progress:
    """In the camera's lane, with a pace of its own, yet never too near nor too far."""
    pace = Wander.draw(rng, [1.0], (0.05, 0.2))
    low, high = headway_m - 10.0 + _GAP_M[0], _GAP_M[1] + headway_m

    def progress(time_s: float) -> float:
        t = speed * ego.clock(time_s)
        here = ego.progress(time_s)
        own = ego.start_m + headway_m + ego.speed_m_s * t + float(pace(t)[0])
        gap = low + np.logaddexp(0.0, own - here - low)         # smooth maximum
        return float(here + high - np.logaddexp(0.0, high - gap))

    return progress


def _turning(rng: np.random.Generator, plan: TownPlan, speed: float
             ) -> tuple[ClosedPath, Progress]:
    """Out of the side street in the south, right at the crossing, to a stop in the east."""
    lane, far = LANE_M / 2.0, ROAD_M + 34.0
    x, y = plan.width_m + lane, -lane
    path = ClosedPath([[x, y - far - 40.0], [x, y], [x + far + 40.0, y],
                       [x + far + 40.0, y - far - 40.0]], 7.0)
    start = path.nearest((x, -rng.uniform(20.0, 26.0)))
    stop = path.nearest((plan.width_m + far - 7.0, y))
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


def _parking_spots(plan: TownPlan) -> list[Spot]:
    """Along the kerbs of the first two roads that the camera drives, and of the others."""
    width, height, strip = plan.width_m, plan.height_m, PARKING_M
    spots: list[Spot] = [((x, -strip), 0.0) for x in np.arange(14.0, width - 12.0, 9.0)]
    spots += [((x, strip), np.pi) for x in np.arange(16.0, width - 12.0, 9.0)]
    spots += [((width + strip, y), np.pi / 2) for y in np.arange(14.0, 52.0, 9.0)]
    spots += [((width - strip, y), -np.pi / 2) for y in np.arange(16.0, 52.0, 9.0)]
    spots += [((x, height - strip), 0.0) for x in (20.0, 40.0, 60.0)]
    spots += [((-strip, y), np.pi / 2) for y in (20.0, 40.0)]
    return spots


register_scene(
    name="Street-v0",
    description="a town street with driving, oncoming, turning and parked cars, seen from a car",
    mjcf="street.xml", build=build, dials=DIALS,
    width=1216, height=368, fps=10.0, frames=100,
    most_objects=len(_ROLES) + _CYCLISTS + max(_parked_on(route) for route in ROUTES))
