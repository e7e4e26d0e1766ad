"""How far a scene reaches, so that its depth fits in 16 bits."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.render import SHOWN_GEOM_GROUPS
from slam.geometry import se3
from slam.geometry.arrays import Array

_CORNERS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(8, 3)
_INFINITE_PLANE_M = 60.0   # an endless floor is drawn, and measured, no farther than this


def farthest_depth(model: mujoco.MjModel, T_world_camera: Array, T_world_part: Array) -> float:
    """Largest z-depth in metres that any corner of any drawn geom's box has in any frame.

    It bounds what can be seen; what is behind a wall counts, too.

    Args:
        T_world_camera: (K, 4, 4).
        T_world_part: (K, P, 4, 4), parts being MuJoCo bodies.
    """
    drawn = np.flatnonzero(np.array(SHOWN_GEOM_GROUPS, bool)[np.minimum(model.geom_group, 5)])
    centre, half = model.geom_aabb[drawn, :3].copy(), model.geom_aabb[drawn, 3:].copy()
    planes = model.geom_type[drawn] == mujoco.mjtGeom.mjGEOM_PLANE
    half[planes] = np.where(model.geom_size[drawn][planes] > 0, model.geom_size[drawn][planes],
                            _INFINITE_PLANE_M)
    half[planes, 2], centre[planes] = 0.0, 0.0
    R = se3.rotation_from_quaternion(np.roll(model.geom_quat[drawn], -1, axis=-1))
    T_part_geom = se3.from_rotation_translation(R, model.geom_pos[drawn])
    corners = se3.transform_points(T_part_geom, centre[:, None] + half[:, None] * _CORNERS)
    forward = T_world_camera[:, :3, 2]
    reach_m = 0.0
    for k, T_part in enumerate(T_world_part):
        points = se3.transform_points(T_part[model.geom_bodyid[drawn]], corners)
        reach_m = max(reach_m, float(np.max((points - T_world_camera[k, :3, 3]) @ forward[k],
                                            initial=0.0)))
    return reach_m
