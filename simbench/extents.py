"""How large the drawn things of a compiled scene are."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.render import SHOWN_GEOM_GROUPS
from slam.geometry import se3
from slam.geometry.arrays import Array

_SIGNS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(8, 3)
_INFINITE_PLANE_M = 60.0   # an endless floor is drawn, and measured, no farther than this


def drawn_corners(model: mujoco.MjModel) -> tuple[Array, Array]:
    """The part (G,) of each drawn geom, and the corners (G, 8, 3) of its box in that part, m."""
    drawn = np.flatnonzero(np.array(SHOWN_GEOM_GROUPS, bool)[np.minimum(model.geom_group, 5)])
    centre, half = model.geom_aabb[drawn, :3].copy(), model.geom_aabb[drawn, 3:].copy()
    planes = model.geom_type[drawn] == mujoco.mjtGeom.mjGEOM_PLANE
    half[planes] = np.where(model.geom_size[drawn][planes] > 0, model.geom_size[drawn][planes],
                            _INFINITE_PLANE_M)
    half[planes, 2], centre[planes] = 0.0, 0.0
    R = se3.rotation_from_quaternion(np.roll(model.geom_quat[drawn], -1, axis=-1))
    T_part_geom = se3.from_rotation_translation(R, model.geom_pos[drawn])
    corners = se3.transform_points(T_part_geom, centre[:, None] + half[:, None] * _SIGNS)
    return model.geom_bodyid[drawn].copy(), corners


def part_boxes(model: mujoco.MjModel) -> Array:
    """(P, 2, 3) lowest and highest corner of each part's drawn surface in the part's own frame.

    NaN for a part of which nothing is drawn.
    """
    part, corners = drawn_corners(model)
    lowest, highest = np.full((2, model.nbody, 3), np.inf)
    np.minimum.at(lowest, part, corners.min(axis=1))
    np.minimum.at(highest, part, -corners.max(axis=1))
    boxes = np.stack([lowest, -highest], axis=1)
    boxes[~np.isfinite(boxes).all(axis=(1, 2))] = np.nan
    return boxes
