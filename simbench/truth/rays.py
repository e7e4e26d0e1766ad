"""Rays against the true surfaces of a scene, with its parts wherever they are said to be."""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import numpy as np

from simbench.render.geometry import shown_geoms
from simbench.truth.surface import TOLERANCE_M, TOLERANCE_RELATIVE
from simbench.truth.triangles import DRAWN_AS_TRIANGLES, screen_of, triangles_of
from simbench.types import FrameTruth
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

Hides = Callable[[Array], Array]   # (N, 3) pixels and z-depth to (N,) bool: hidden there
_CURVED_GROUP = 0


class RayCaster:
    """Casts rays at the drawn geoms of a compiled model.

    It needs part poses only, so that it serves any instant of a sequence, live or read from
    disk, and never disturbs the world that moves.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._parts = int(model.nbody)
        self._triangles = triangles_of(model)
        shown = shown_geoms(model)
        curved = shown[~np.isin(model.geom_type[shown], [int(k) for k in DRAWN_AS_TRIANGLES])]
        self._curved = _CurvedGeoms(model, curved) if len(curved) else None

    def hides(self, truth: FrameTruth, intrinsics: Intrinsics) -> Hides:
        """A function that says which points, given in one frame's image, something hides there.

        A point is hidden when its ray meets a surface nearer than it by more than the truth's
        tolerance.

        Raises:
            ValueError: the frame is of another scene.
        """
        if len(truth.T_world_part) != self._parts:
            raise ValueError(f"this scene has {self._parts} parts, not {len(truth.T_world_part)}")
        screen = screen_of(self._triangles, truth.T_world_part, truth.T_world_camera, intrinsics)

        def hides(uvz: Array) -> Array:
            before_m = uvz[:, 2] - np.maximum(TOLERANCE_M, TOLERANCE_RELATIVE * uvz[:, 2])
            hidden = screen.anything_before(uvz[:, :2], 1.0 / before_m)
            if self._curved is not None:
                hidden |= self._curved.nearest(uvz[:, :2], truth, intrinsics) < before_m
            return hidden

        return hides


class _CurvedGeoms:
    """Spheres, cylinders and their like have no triangles: MuJoCo casts at those only."""

    def __init__(self, model: mujoco.MjModel, geoms: Array) -> None:
        self._model = copy.copy(model)
        self._model.geom_group[:] = _CURVED_GROUP + 1
        self._model.geom_group[geoms] = _CURVED_GROUP
        self._group = np.eye(6, dtype=np.uint8)[_CURVED_GROUP]
        self._data = mujoco.MjData(self._model)
        R = se3.rotation_from_quaternion(np.roll(model.geom_quat, -1, axis=-1))
        self._T_part_geom = se3.from_rotation_translation(R, model.geom_pos)

    def nearest(self, uv: Array, truth: FrameTruth, intrinsics: Intrinsics) -> Array:
        """(N,) z-depth of the first hit of the rays through pixels (N, 2); inf where none."""
        T_world_geom = truth.T_world_part[self._model.geom_bodyid] @ self._T_part_geom
        self._data.geom_xpos[:] = T_world_geom[:, :3, 3]
        self._data.geom_xmat[:] = T_world_geom[:, :3, :3].reshape(-1, 9)
        pixels = np.concatenate([uv, np.ones((len(uv), 1))], axis=1)
        to_world = truth.T_world_camera[:3, :3] @ np.linalg.inv(intrinsics.matrix)
        rays = np.ascontiguousarray(pixels @ to_world.T)
        geom, depth = np.full(len(uv), -1, np.int32), np.full(len(uv), -1.0)
        if len(uv):
            mujoco.mj_multiRay(self._model, self._data, truth.T_world_camera[:3, 3], rays.ravel(),
                               self._group, True, -1, geom, depth, None, len(uv),
                               mujoco.mjMAXVAL)
        return np.where(geom < 0, np.inf, depth)
