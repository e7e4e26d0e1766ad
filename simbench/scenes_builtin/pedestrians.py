"""People on the pavements of a town."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath
from simbench.scene import SceneObject
from simbench.scenes_builtin.gait import Walker
from simbench.scenes_builtin.people import Figure, add_person, edgeless_materials
from simbench.scenes_builtin.roadside import KERB_M
from simbench.scenes_builtin.town import ROAD_M, TownPlan
from slam.geometry.arrays import Array

# Behind the kerb, between lamps and house fronts: room for two lanes of people.
_NEAR_KERB_M, _NEAR_HOUSES_M = 1.25, 1.95


@dataclass(frozen=True, slots=True)
class Pedestrians:
    """Walkers and the materials that have no edges."""

    walkers: tuple[Walker, ...]

    @property
    def objects(self) -> list[SceneObject]:
        return [SceneObject(each.name, rigid=False, category="person") for each in self.walkers]

    @property
    def edgeless(self) -> tuple[str, ...]:
        return tuple(material for each in self.walkers
                     for material in edgeless_materials(each.name))


def add_pedestrians(spec: mujoco.MjSpec, rng: np.random.Generator, plan: TownPlan, count: int,
                    speed: float) -> Pedestrians:
    """`count` people who walk round the block both ways, and to and fro on the other side.

    Those on one path have one pace and start evenly spread, so that nobody runs into anybody.
    """
    paths = _paths(plan)
    order = [0, 2, 1, 3, 0, 4, 1, 5]
    of_path = [order[number % len(order)] for number in range(count)]
    pace = rng.uniform(1.0, 1.35, len(paths))
    first = rng.uniform(0.0, 1.0, len(paths))
    walkers = []
    for number, which in enumerate(of_path):
        name, figure = f"person {number + 1}", Figure(float(rng.uniform(1.60, 1.86)))
        add_person(spec, name, figure, rng)
        path, together = paths[which], of_path.count(which)
        share = (of_path[:number].count(which) + rng.uniform(-0.2, 0.2)) / together
        start = (first[which] + share) * path.length_m
        walkers.append(Walker(name, figure, path, _steady(start, speed * pace[which]),
                              floor_m=KERB_M))
    return Pedestrians(tuple(walkers))


def _steady(start_m: float, speed_m_s: float) -> Callable[[float], float]:
    return lambda time_s: start_m + speed_m_s * time_s


def _paths(plan: TownPlan) -> list[ClosedPath]:
    """Two round the block, and one along each of the four pavements opposite it."""
    width, height = plan.width_m, plan.height_m

    def ring(inwards: float) -> Array:
        i = ROAD_M + inwards
        return np.array([[i, i], [width - i, i], [width - i, height - i], [i, height - i]])

    paths = [ClosedPath(ring(_NEAR_KERB_M), 0.8, 0.3),
             ClosedPath(ring(_NEAR_HOUSES_M)[::-1], 0.8, 0.3)]
    near, far, end = ROAD_M + _NEAR_KERB_M, ROAD_M + _NEAR_HOUSES_M, ROAD_M + 3.0
    for low, high in ((-far, -near), (height + near, height + far)):
        paths.append(ClosedPath([[end, low], [width - end, low], [width - end, high], [end, high]],
                                0.34, 0.1))
    for low, high in ((-far, -near), (width + near, width + far)):
        paths.append(ClosedPath([[low, end], [high, end], [high, height - end],
                                 [low, height - end]], 0.34, 0.1))
    return paths

