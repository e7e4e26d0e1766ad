"""Loop-v0: once round a block of a town and some way on, where the camera has been before.

The counterpart of the KITTI odometry recordings: 10 frames a second, a wide image, a way that
closes. Every house has a facade of its own, so that places can be told apart by their looks.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath, Wander
from simbench.randomise import generator, hue_rgba, set_texture
from simbench.scene import Dial, Dials, Placement, Staging, register_scene
from simbench.scenes_builtin.cars import add_all_car_meshes
from simbench.scenes_builtin.houses import HouseStyle, TownMeshes
from simbench.scenes_builtin.pace import Pace, kept_between
from simbench.scenes_builtin.pedestrians import add_pedestrians
from simbench.scenes_builtin.town import LANE_M, TownPlan, build_town
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

_PLAN = TownPlan(width_m=66.0, height_m=52.0)
_ROUND_S = (30.0, 32.5)       # for one time round the block
_SIDEWAYS_M_S2 = 2.0          # acceleration in turns, at which drivers slow down
_CRUISE_M_S = 8.5
_GAP_S = (1.9, 9.0)           # cars ahead keep this time from the camera, whatever the dials say
_PARKED, _PEOPLE = 14, 16
_ROLES = ("oncoming", "ahead", "oncoming", "oncoming", "oncoming", "ahead", "oncoming", "oncoming")

DIALS = (
    Dial("rigidity", 1.0, 0.0, 1.0, "below 1 doors and tailgates of driving cars open and close"),
    Dial("speed", 1.0, 0.0, 3.0, "of cars and people, as a factor of 4 to 8 and 1 to 1.35 m/s"),
    Dial("camera_speed", 1.0, 0.0, 3.0, "of the camera's car; at 1 it is round in 300 to 325 "
         "frames"),
    Dial("objects", 5.0, 0.0, float(len(_ROLES)), "number of driving cars", integer=True),
    Dial("people", 8.0, 0.0, float(_PEOPLE), "number of people on the pavements", integer=True),
)

_FACADES = ("brick", "plaster", "blocks", "siding", "concrete", "rubble", "timber", "tiles",
            "panels", "planks")
_PANES = ("pane", "casement", "blind")
_SIGNS = (*(f"poster_{letter}" for letter in "abcdefgh"), "mosaic", "triangles", "stars")


def build(spec: mujoco.MjSpec, seed: int, dials: Dials) -> Staging:
    """Build the town, park cars in it, and set others and the people going."""
    town = TownMeshes()
    town.draw_style = _Styles(spec, town)
    build_town(spec, generator(seed, 0), _PLAN, town)
    opening, speed = 1.0 - dials["rigidity"], dials["speed"]
    add_all_car_meshes(spec, flaps=opening > 0.0)
    raise_sun(spec, generator(seed, 1))
    parked = park_cars(spec, generator(seed, 2), _parking_spots(), _PARKED)
    ego = Ego.draw(generator(seed, 3), dials["camera_speed"])
    drivers = _draw_traffic(spec, generator(seed, 4), ego, round(dials["objects"]), speed)
    traffic = Traffic(ego.camera, drivers, opening, speed)
    driving = traffic.add_to(spec)
    people = add_pedestrians(spec, generator(seed, 5), _PLAN, round(dials["people"]), speed)

    def script(time_s: float) -> Placement:
        placement = traffic.placed(time_s)
        for walker in people.walkers:
            placement |= walker(time_s)
        return placement

    return Staging(script, (*driving, *parked, *people.objects), shortest_edge_m=0.25,
                   edgeless=("leaves", *people.edgeless))


class _Styles:
    """Gives every house a facade, and most of them windows, that no other has."""

    def __init__(self, spec: mujoco.MjSpec, town: TownMeshes) -> None:
        self._spec, self._town = spec, town
        self._count, self._deck, self._hue = 0, list[str](), 0.0

    def __call__(self, rng: np.random.Generator) -> HouseStyle:
        if not self._deck:
            self._deck = [str(each) for each in rng.permutation(_FACADES)]
        number, self._count = self._count, self._count + 1
        # Neighbours have other textures; the next with the same one has quite another colour.
        self._hue += 0.382 + 0.1 * rng.uniform()
        tint = hue_rgba(self._hue, rng.uniform(0.05, 0.32), rng.uniform(0.72, 1.0))
        facade = self._material(f"facade {number}", self._deck.pop(), tint)
        self._town.tiles[facade] = float(rng.uniform(0.22, 0.40))
        pane = self._material(f"pane {number}", str(rng.choice(_PANES)),
                              hue_rgba(rng.uniform(), rng.uniform(0.0, 0.25), 1.0))
        door = self._material(f"door {number}", "door",
                              hue_rgba(rng.uniform(), rng.uniform(0.2, 0.6), 0.75))
        signs = [self._material(f"sign {number} {side}", str(texture), [1.0, 1.0, 1.0, 1.0])
                 for side, texture in zip("ab", rng.permutation(_SIGNS)[:2], strict=True)]
        return HouseStyle(facade, pane, door, (signs[0], signs[1]))

    def _material(self, name: str, texture: str, rgba: list[float]) -> str:
        set_texture(self._spec.add_material(name=name, rgba=rgba, specular=0.0), texture)
        return name


@dataclass(frozen=True, slots=True)
class Ego:
    """The car that carries the camera; its way and its pace are the seed's."""

    path: ClosedPath
    clockwise: bool
    pace: Pace
    start_s: float
    hesitation: Wander     # s on the driver's clock
    eye: CarCamera
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, factor: float) -> Ego:
        clockwise = bool(rng.integers(2))
        lane = LANE_M / 2.0
        path = block_loop(_PLAN, -lane if clockwise else lane, clockwise)
        pace = Pace(path, _CRUISE_M_S, _SIDEWAYS_M_S2, rng.uniform(*_ROUND_S))
        x = rng.uniform(13.0, 17.0)
        start = path.nearest((_PLAN.width_m - x, lane) if clockwise else (x, -lane))
        return cls(path, clockwise, pace, pace.clock_at(start),
                   Wander.draw(rng, [0.10], (0.05, 0.15)), CarCamera.draw(rng, path), factor)

    def clock(self, time_s: float) -> float:
        t = self.factor * time_s
        return self.start_s + t + float(self.hesitation(t)[0])

    def camera(self, time_s: float) -> Array:
        """T_world_camera (4, 4)."""
        return self.eye(self.pace(self.clock(time_s)), self.factor * time_s)


def _draw_traffic(spec: mujoco.MjSpec, rng: np.random.Generator, ego: Ego, count: int,
                  speed: float) -> tuple[Driver, ...]:
    """The driving cars, by their roles."""
    roles = _ROLES[:count]
    lane = LANE_M / 2.0
    other_path = block_loop(_PLAN, lane if ego.clockwise else -lane, not ego.clockwise)
    round_s = rng.uniform(*_ROUND_S)
    oncoming = Pace(other_path, _CRUISE_M_S, _SIDEWAYS_M_S2, round_s)
    first, apart = rng.uniform(0.0, round_s), round_s / max(1, roles.count("oncoming"))
    headway, drivers = rng.uniform(2.6, 3.2), []
    for number, role in enumerate(roles, start=1):
        if role == "ahead":
            path, progress = ego.path, _ahead_of(ego, headway, speed, rng)
            headway += rng.uniform(2.4, 3.2)
        else:
            nth = roles[:number].count("oncoming") - 1
            path, progress = other_path, _steady(oncoming, first + nth * apart, speed)
        drivers.append(draw_driver(spec, rng, number, role == "ahead", path, progress))
    return tuple(drivers)


def _steady(pace: Pace, start_s: float, speed: float) -> Progress:
    return lambda time_s: pace(start_s + speed * time_s)


def _ahead_of(ego: Ego, headway_s: float, speed: float, rng: np.random.Generator) -> Progress:
    """In the camera's lane, with a pace of its own, yet never too near nor too far."""
    hesitation = Wander.draw(rng, [0.15], (0.05, 0.2))
    low, high = headway_s - 2.6 + _GAP_S[0], _GAP_S[1] + headway_s

    def progress(time_s: float) -> float:
        t = speed * time_s
        here = ego.clock(time_s)
        own = ego.start_s + headway_s + t + float(hesitation(t)[0])
        return ego.pace(here + kept_between(own - here, low, high))

    return progress


def _parking_spots() -> list[Spot]:
    """Along both kerbs of the four roads, away from the crossings."""
    width, height, strip = _PLAN.width_m, _PLAN.height_m, PARKING_M
    spots: list[Spot] = []
    for x in np.arange(14.0, width - 12.0, 8.5):
        for y in (0.0, height):
            spots += [((x, y - strip), 0.0), ((x, y + strip), np.pi)]
    for y in np.arange(14.0, height - 12.0, 8.5):
        for x in (0.0, width):
            spots += [((x + strip, y), np.pi / 2), ((x - strip, y), -np.pi / 2)]
    return spots


register_scene(
    name="Loop-v0",
    description="once round a block of a town with cars and people, and on where it began; "
                "for stereo and loop closing",
    mjcf="loop.xml", build=build, dials=DIALS,
    width=1216, height=368, fps=10.0, frames=360,
    most_objects=len(_ROLES) + _PARKED + _PEOPLE)
