"""What creeps: the motions of many frames added up, of things whose single ones hide in noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.dynamics.scene_flow import BodySteps, CameraStep, speed_sigma
from slam.geometry.arrays import Array

_MEMORY = 0.9          # of the frames before: ten of them, about
_SIGNIFICANCE = 5.0    # standard deviations of what has been added up


@dataclass(frozen=True, slots=True)
class Drift:
    """How far a thing's middle has moved in the world, earlier frames counting less."""

    moved_m: Array     # (3,)
    variance: float    # m², of all three coordinates together


STILL = Drift(np.zeros(3), 0.0)


def added(drifts: list[Drift], camera: CameraStep, bodies: BodySteps, T_world_a: Array
          ) -> list[Drift]:
    """The drifts of G things (those before, one each) with one step more.

    Args:
        T_world_a: (4, 4); the steps are given in camera a.
    """
    middle = np.array([np.mean(f.xyz_a, axis=0) if len(f.xyz_a) else np.zeros(3)
                       for f in bodies.followers]).reshape(-1, 3)
    step_m = np.einsum("gij,gj->gi", bodies.relative[:, :3, :3], middle) \
        + bodies.relative[:, :3, 3] - middle
    step_m = step_m @ T_world_a[:3, :3].T
    every = np.concatenate([camera.information[None], bodies.information])
    each = np.arange(len(middle))
    sigma = speed_sigma(every, middle, np.zeros_like(each)) + speed_sigma(every, middle, 1 + each)
    return [Drift(_MEMORY * before.moved_m + step_m[g],
                  _MEMORY**2 * before.variance + float(sigma[g])**2)
            for g, before in enumerate(drifts)]


def creeps(drift: Drift) -> bool:
    """Whether it has moved beyond what noise explains."""
    return float(np.linalg.norm(drift.moved_m)) > _SIGNIFICANCE * np.sqrt(drift.variance)
