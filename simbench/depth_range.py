"""How far a scene reaches, so that its depth fits in 16 bits."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.extents import drawn_corners
from slam.geometry import se3
from slam.geometry.arrays import Array


def farthest_depth(model: mujoco.MjModel, T_world_camera: Array, T_world_part: Array) -> float:
    """Largest z-depth in metres that any corner of any drawn geom's box has in any frame.

    It bounds what can be seen; what is behind a wall counts, too.

    Args:
        T_world_camera: (K, 4, 4).
        T_world_part: (K, P, 4, 4), parts being MuJoCo bodies.
    """
    part, corners = drawn_corners(model)
    forward = T_world_camera[:, :3, 2]
    reach_m = 0.0
    for k, T_part in enumerate(T_world_part):
        points = se3.transform_points(T_part[part], corners)
        reach_m = max(reach_m, float(np.max((points - T_world_camera[k, :3, 3]) @ forward[k],
                                            initial=0.0)))
    return reach_m
