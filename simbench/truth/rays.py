"""Rays against the true surfaces of a scene, with its parts wherever they are said to be."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.render import SHOWN_GEOM_GROUPS
from slam.geometry import se3
from slam.geometry.arrays import Array


class RayCaster:
    """Casts rays at the drawn geoms of a compiled model.

    It holds a state of its own, set by part poses alone, so that it serves any instant of a
    sequence, live or read from disk, and never disturbs the world that moves.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._data)
        self._groups = np.array(SHOWN_GEOM_GROUPS, np.uint8)
        self._T_part_geom = _local_poses(model.geom_pos, model.geom_quat)
        self._T_part_inertia = _local_poses(model.body_ipos, model.body_iquat)

    def place(self, T_world_part: Array) -> None:
        """Put every part (P, 4, 4) where it is to be hit."""
        model, data = self._model, self._data
        if np.shape(T_world_part) != (model.nbody, 4, 4):
            raise ValueError(f"this scene has {model.nbody} parts, not {np.shape(T_world_part)[0]}")
        T_world_geom = T_world_part[model.geom_bodyid] @ self._T_part_geom
        T_world_inertia = T_world_part @ self._T_part_inertia
        data.geom_xpos[:] = T_world_geom[:, :3, 3]
        data.geom_xmat[:] = T_world_geom[:, :3, :3].reshape(-1, 9)
        data.xpos[:] = T_world_part[:, :3, 3]
        data.xmat[:] = T_world_part[:, :3, :3].reshape(-1, 9)
        data.xipos[:] = T_world_inertia[:, :3, 3]
        data.ximat[:] = T_world_inertia[:, :3, :3].reshape(-1, 9)

    def cast(self, origin: Array, directions: Array) -> tuple[Array, Array]:
        """First hits of rays from one point.

        Args:
            origin: (3,) m in the world.
            directions: (N, 3) in the world, of any length.
        Returns:
            (N,) distances in units of each direction's length, inf where nothing is hit;
            (N,) int32 parts, -1 where nothing is hit.
        """
        count = len(directions)
        geom, distance = np.full(count, -1, np.int32), np.full(count, -1.0)
        if count:
            rays = np.ascontiguousarray(directions, np.float64).reshape(-1)
            mujoco.mj_multiRay(self._model, self._data, np.asarray(origin, np.float64), rays,
                               self._groups, True, -1, geom, distance, None, count,
                               mujoco.mjMAXVAL)
        missed = geom < 0
        parts = np.where(missed, np.int32(-1), self._model.geom_bodyid[geom])
        return np.where(missed, np.inf, distance), parts


def _local_poses(positions: Array, quat_wxyz: Array) -> Array:
    rotations = se3.rotation_from_quaternion(np.roll(quat_wxyz, -1, axis=-1))
    return se3.from_rotation_translation(rotations, positions)
