"""A map whose depths turn out to have an offset."""

from __future__ import annotations

import numpy as np

from slam.dpl.adjust import adjust_all
from slam.dpl.config import DplConfig
from slam.dpl.keyframes import PointLineMap
from slam.dpl.landmarks import Landmarks
from slam.dpl.memory import LandmarkMemory
from slam.estimation.calibration import shifted_inverse
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_ITERATIONS = 10         # of the adjustment: all steps were too long, or too short


def recalibrate(map_: PointLineMap, memory: LandmarkMemory, offset: float, camera: Intrinsics,
                config: DplConfig) -> None:
    """Add an offset, 1/m, to all depths that made the map, and adjust it whole.

    Landmarks move along the rays on which their keyframes saw them first. How far the keyframes are
    apart follows from that, as it did.
    """
    poses = map_.poses()
    for keyframe in map_.living():
        keyframe.features = keyframe.features.shifted(offset)
    for table in (map_.points, map_.lines):
        _shift(table, poses, offset)
    memory.anchors.shift(offset)
    adjust_all(map_, camera, config, _ITERATIONS)


def _shift(table: Landmarks, T_world_camera: Array, offset: float) -> None:
    """Landmarks moved along the rays from the keyframes, of poses (K, 4, 4), that made them."""
    T = T_world_camera[table.born]
    seen = se3.transform_points(se3.inverse(T), table.xyz)
    ahead = seen[:, :, 2] > 0
    rho = 1.0 / np.where(ahead, seen[:, :, 2], 1.0)
    factor = np.where(ahead, rho / shifted_inverse(rho, offset), 1.0)
    table.xyz[:] = se3.transform_points(T, factor[:, :, None] * seen)
    table.distance[:] *= factor.mean(axis=1)
