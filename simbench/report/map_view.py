"""The map that a system made, for the report."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simbench.metrics.camera import gauge
from simbench.metrics.estimates import CameraEstimates
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.types import SlamResult


@dataclass(frozen=True, slots=True)
class MapView:
    """What a system mapped, in one world, metres."""

    points: Array        # (P, 3)
    lines: Array         # (L, 2, 3)
    path: Array          # (K, 3) of the camera, as `finish` gave it
    loops: Array         # (N, 3) where the camera closed loops

    def __post_init__(self) -> None:
        freeze_fields(self, points=("P", 3), lines=("L", 2, 3), path=("K", 3), loops=("N", 3))


def map_of(result: SlamResult | None, camera: CameraEstimates, truth: Trajectories | None
           ) -> MapView | None:
    """The map in the true world, by the first frame with both; without truth in its own.

    None where a system has no map.
    """
    if result is None or (result.points_world is None and result.lines_world is None):
        return None
    points = np.zeros((0, 3)) if result.points_world is None else result.points_world
    lines = np.zeros((0, 2, 3)) if result.lines_world is None else result.lines_world
    points = points[np.isfinite(points).all(axis=1)]
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if not len(points) and not len(lines):
        return None
    path = result.T_world_camera[:, :3, 3]
    loops = np.zeros((0, 3)) if result.loops is None else path[result.loops.row]
    S = np.eye(4) if truth is None else gauge(camera, truth)
    S = np.eye(4) if S is None else S
    return MapView(*(se3.transform_points(S, each.reshape(-1, 3)).reshape(each.shape)
                     for each in (points, lines, path, loops)))
