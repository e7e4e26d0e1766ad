"""Geoms of a compiled model as triangle meshes, for renderers that know nothing of MuJoCo."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from simbench.errors import UserError
from simbench.render import SHOWN_GEOM_GROUPS
from slam.geometry.arrays import Array

# Corner i of a box has the signs of the bits of i (x, y, z); faces turn outward.
_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_BOX_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
_PLANE_CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
_PLANE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def shown_geoms(model: Any) -> Array:
    """Numbers of the geoms that are drawn and hit by rays: of a shown group, not transparent."""
    shown = np.array(SHOWN_GEOM_GROUPS, bool)[np.clip(model.geom_group, 0, 5)]
    return np.flatnonzero(shown & (geom_colours(model)[:, 3] > 0.0))


def geom_colours(model: Any) -> Array:
    """(G, 4) red, green, blue, alpha in 0..1 of each geom; its material's where it has one."""
    colours = model.geom_rgba.copy()
    with_material = model.geom_matid >= 0
    # MuJoCo lets a geom's own colour win unless it was left at its default.
    default = np.all(colours == np.array([0.5, 0.5, 0.5, 1.0], np.float32), axis=-1)
    taken = with_material & default
    colours[taken] = model.mat_rgba[model.geom_matid[taken]]
    return colours


def geom_triangles(model: Any, geom: int, far_m: float) -> tuple[Array, Array]:
    """(V, 3) vertices in the geom's frame and (F, 3) faces of a box, a plane or a mesh.

    Args:
        far_m: half the size that an endless plane is given.
    Raises:
        UserError: the geom is of another kind.
    """
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _BOX_CORNERS * size, _BOX_FACES
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        half = np.array([size[0] or far_m, size[1] or far_m, 0.0])
        return _PLANE_CORNERS * half, _PLANE_FACES
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
        return (model.mesh_vert[vertex:vertex + model.mesh_vertnum[mesh]],
                model.mesh_face[face:face + model.mesh_facenum[mesh]])
    raise UserError(f"geom {model.geom(geom).name!r} is neither box, plane nor mesh: the pyrender "
                    "renderer does not draw it; make it a mesh, or render with mujoco")
