"""Cyclists on the right of the driving lanes, who pedal: objects that are not rigid."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from simbench.motion import ClosedPath, Wander, pose
from simbench.scene import SceneObject
from simbench.scenes_builtin.bicycle import add_cyclist, cyclist_angles
from simbench.scenes_builtin.people import Figure, edgeless_materials
from simbench.scenes_builtin.traffic import Progress
from slam.geometry.arrays import Array

# Between the cars that drive and those that park, half a metre of handlebar and no more.
BESIDE_LANE_M = 3.14          # from the middle of the road
_ROUND_M = 3.6                # of the way for one turn of the cranks
_GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class Cyclist:
    """Somebody on a bicycle."""

    name: str
    figure: Figure
    path: ClosedPath
    progress: Progress
    limbs: float
    weave: Wander       # m sideways

    @classmethod
    def add_to(cls, spec: mujoco.MjSpec, rng: np.random.Generator, name: str, path: ClosedPath,
               progress: Progress, limbs: float) -> Cyclist:
        figure = add_cyclist(spec, name, rng, limbs)
        return cls(name, figure, path, progress, limbs, Wander.draw(rng, [0.015], (0.05, 0.3)))

    @property
    def object(self) -> SceneObject:
        return SceneObject(self.name, rigid=self.limbs == 0.0, category="bicycle")

    @property
    def edgeless(self) -> tuple[str, ...]:
        return (f"{self.name} tyre", f"{self.name} steel",
                *edgeless_materials(f"{self.name} rider"))

    def placed(self, time_s: float) -> dict[str, Array | float]:
        """Pose, leaning into the turn, and all joints at that time."""
        travelled = self.progress(time_s)
        (x, y), heading = self.path(travelled)
        step = 0.5
        ahead, behind = (self.path(travelled + each)[1] for each in (step, -step))
        turn = (ahead - behind + np.pi) % (2.0 * np.pi) - np.pi
        speed = (self.progress(time_s + 0.05) - self.progress(time_s - 0.05)) / 0.1
        lean = np.arctan(speed**2 * turn / (2.0 * step) / _GRAVITY_M_S2)
        side = float(self.weave(travelled / 5.0)[0])
        at = [x - side * np.sin(heading), y + side * np.cos(heading), 0.0]
        placed: dict[str, Array | float] = {self.name: pose(at, heading, 0.0, -float(lean))}
        pedalled = 2.0 * np.pi * travelled / _ROUND_M
        return placed | cyclist_angles(self.name, self.figure, travelled, pedalled, self.limbs)
