"""Flat-faced textured meshes: building them, and baking many static boxes into a few of them.

Software OpenGL and ray casting both pay for every geom; a mesh of thousands of faces is one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from slam.geometry.arrays import Array

# Corners of a box by their signs, each face counter-clockwise as seen from outside.
_FACES = np.array([
    [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]],
    [[-1, 1, -1], [-1, -1, -1], [-1, -1, 1], [-1, 1, 1]],
    [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]],
    [[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]],
    [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    [[-1, 1, -1], [1, 1, -1], [1, -1, -1], [-1, -1, -1]]], float)
_FIT_UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


class MeshBuilder:
    """Gathers quads, each with its own corners, normal and texture coordinates."""

    def __init__(self) -> None:
        self._corners: list[Array] = []
        self._uv: list[Array] = []       # NaN: to be made from the corners
        self._scale: list[Array] = []    # (Q, 3): tiles per metre and shift, for those

    def __len__(self) -> int:
        return sum(len(each) for each in self._corners)

    def quads(self, corners: ArrayLike, uv: Array | None = None, scale: float = 1.0,
              shift: ArrayLike = (0.0, 0.0)) -> None:
        """Add quads.

        Args:
            corners: (Q, 4, 3) m, counter-clockwise as seen from outside; a triangle repeats one.
                Quads without area are left out.
            uv: (Q, 4, 2) texture coordinates; None: `metric_uv` times `scale` (tiles per metre)
                plus `shift`.
        """
        corners = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
        self._corners.append(corners)
        self._uv.append(np.full((len(corners), 4, 2), np.nan) if uv is None else uv)
        self._scale.append(np.broadcast_to([scale, *np.asarray(shift)], (len(corners), 3)))

    def box(self, centre: ArrayLike, size: ArrayLike, R: Array | None = None, scale: float = 1.0,
            shift: ArrayLike = (0.0, 0.0), fit: bool = False, tile_m: float | None = None) -> None:
        """Add a box of full `size` (3,); `fit` puts the texture once on each face.

        `tile_m` splits the faces into pieces of about that size, for lights that are computed at
        the corners only.
        """
        corners = _FACES * (np.asarray(size) / 2.0)
        uv = np.broadcast_to(_FIT_UV, (6, 4, 2)) if fit else metric_uv(corners)
        if tile_m is not None:
            corners, uv = _split(corners, uv, tile_m)
        placed = corners if R is None else corners @ R.T
        self.quads(placed + np.asarray(centre), uv * scale + np.asarray(shift))

    def placed_box(self, centre: ArrayLike, size: ArrayLike, scale: float = 1.0,
                   shift: ArrayLike = (0.0, 0.0)) -> None:
        """Add an upright box whose texture depends on where it stands: it runs on to neighbours."""
        self.quads(_FACES * (np.asarray(size) / 2.0) + np.asarray(centre), None, scale, shift)

    def merge(self, other: MeshBuilder, place: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Add all quads of another builder, moved by `place` (3,) m, textures as they are there."""
        for corners, uv, scale in zip(other._corners, other._uv, other._scale, strict=True):
            made = metric_uv(corners) * scale[:, None, :1] + scale[:, None, 1:]
            self.quads(corners + np.asarray(place), np.where(np.isnan(uv), made, uv))

    def add_to(self, spec: mujoco.MjSpec, name: str, smooth: bool = False) -> None:
        """Put the mesh into `spec`; `smooth` rounds the shading over edges below 35 degrees."""
        corners, uv, scale = (np.concatenate(each) for each in
                              (self._corners, self._uv, self._scale))
        has_area = np.linalg.norm(_diagonals_cross(corners), axis=1) > 1e-9
        corners, uv, scale = corners[has_area], uv[has_area], scale[has_area]
        metric = metric_uv(corners) * scale[:, None, :1] + scale[:, None, 1:]
        uv = np.where(np.isnan(uv), metric, uv)
        normal = _quad_normals(corners)
        normals = _smoothed(corners, normal) if smooth else np.repeat(normal[:, None], 4, axis=1)
        index = np.arange(4 * len(corners)).reshape(-1, 4)
        faces = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
        triangle = corners.reshape(-1, 3)[faces]
        area = np.linalg.norm(_cross(triangle[:, 1] - triangle[:, 0],
                                     triangle[:, 2] - triangle[:, 0]), axis=1)
        mesh = spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        mesh.uservert = corners.reshape(-1).tolist()
        mesh.usernormal = normals.reshape(-1).tolist()
        mesh.usertexcoord = uv.reshape(-1).tolist()
        faces = faces[area > 1e-10].reshape(-1).tolist()
        mesh.userface, mesh.userfacenormal, mesh.userfacetexcoord = faces, faces, faces


class PlacedMeshes:
    """Mesh builders by place and material: near things share a mesh, far ones do not."""

    def __init__(self, tiles: Mapping[str, float]) -> None:
        """
        Args:
            tiles: texture tiles per metre by material; others have one tile to each face.
        """
        self.builders: dict[tuple[str, str], MeshBuilder] = defaultdict(MeshBuilder)
        self.tiles = dict(tiles)

    def quads(self, place: str, material: str, corners: ArrayLike,
              shift: tuple[float, float] = (0.0, 0.0)) -> None:
        """Add quads (Q, 4, 3) m, counter-clockwise as seen from outside."""
        corners = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
        if material in self.tiles:
            self.builders[place, material].quads(corners, None, self.tiles[material], shift)
        else:
            uv = np.broadcast_to(_FIT_UV, (len(corners), 4, 2))
            self.builders[place, material].quads(corners, uv)

    def box(self, place: str, material: str, centre: ArrayLike, size: ArrayLike) -> None:
        """Add an upright box of full `size` (3,)."""
        fit = material not in self.tiles
        self.builders[place, material].box(centre, size, scale=self.tiles.get(material, 1.0),
                                           fit=fit)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Show all of it on the world body."""
        for (place, material), builder in self.builders.items():
            if len(builder):
                builder.add_to(spec, f"{place} {material}")
                visible_geom(spec.worldbody, f"{place} {material}", material)


def metric_uv(corners: Array) -> Array:
    """Texture coordinates (Q, 4, 2) in metres, upright and unmirrored on every side of a thing."""
    normal = _quad_normals(corners)
    axis = np.argmax(np.abs(normal), axis=1)
    sign = np.sign(np.take_along_axis(normal, axis[:, None], axis=1))
    x, y, z = (corners[..., k] for k in range(3))
    axis = axis[:, None]
    u = np.where(axis == 0, sign * y, np.where(axis == 1, -sign * x, x))
    v = np.where(axis == 2, sign * y, z)
    return np.stack([u, v], axis=-1)


def visible_geom(body: mujoco.MjsBody, mesh: str, material: str, mass: float = 0.0) -> None:
    """Show a mesh on a body: no collisions."""
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, material=material, mass=mass,
                  contype=0, conaffinity=0)


def bake_static_boxes(spec: mujoco.MjSpec, tile_m: float = 0.8) -> None:
    """Replace all box geoms with a material on bodies that never move by a few meshes.

    One mesh for each piece of furniture (body) and material: few enough for OpenGL, and small
    enough in space for rays to pass most of them by. As MuJoCo does for planes, a material with
    texuniform repeats its texture texrepeat times a metre, one without texrepeat times a face.
    """
    model = spec.compile()   # the spec's own elements get their ids
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    builders: dict[tuple[int, str], MeshBuilder] = defaultdict(MeshBuilder)
    geoms = [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_BOX and g.material
             and model.body_weldid[model.geom_bodyid[g.id]] == 0]
    for geom in geoms:
        material = spec.material(geom.material)
        scale, index = float(material.texrepeat[0]), geom.id
        # Equal boxes show different parts of a texture.
        shift = (0.0, 0.0) if not material.texuniform else (0.37 * index % 1.0, 0.61 * index % 1.0)
        builders[int(model.geom_bodyid[index]), geom.material].box(
            data.geom_xpos[index], 2.0 * model.geom_size[index],
            data.geom_xmat[index].reshape(3, 3), scale, shift, not material.texuniform, tile_m)
    for geom in geoms:
        spec.delete(geom)
    for body in list(spec.worldbody.bodies):
        if model.body_weldid[body.id] == 0 and not body.find_all("geom"):
            spec.delete(body)
    for (number, name), builder in builders.items():
        # MuJoCo would make texture coordinates of its own for a material with texuniform.
        spec.material(name).texrepeat, spec.material(name).texuniform = (1.0, 1.0), False
        builder.add_to(spec, f"static {number} {name}")
        visible_geom(spec.worldbody, f"static {number} {name}", name)


def _diagonals_cross(corners: Array) -> Array:
    """(Q, 3) along the normal; it also serves a triangle given as a quad with a double corner."""
    return _cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])


def _cross(a: Array, b: Array) -> Array:
    """(Q, 3) a × b; for meshes of few faces NumPy's own takes ten times as long."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    u, v, w = b[:, 0], b[:, 1], b[:, 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _quad_normals(corners: Array) -> Array:
    normal = _diagonals_cross(corners)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(normal / np.where(length > 0.0, length, 1.0))


def _split(corners: Array, uv: Array, tile_m: float) -> tuple[Array, Array]:
    """Quads cut into grids of pieces not larger than about `tile_m`."""
    out_corners: list[Array] = []
    out_uv: list[Array] = []
    for quad, texture in zip(corners, uv, strict=True):
        counts = [max(1, int(np.ceil(np.linalg.norm(quad[k] - quad[0]) / tile_m))) for k in (1, 3)]
        s, t = np.meshgrid(np.arange(counts[0] + 1) / counts[0],
                           np.arange(counts[1] + 1) / counts[1], indexing="ij")
        for source, out in ((quad, out_corners), (texture, out_uv)):
            grid = source[0] + s[..., None] * (source[1] - source[0]) \
                + t[..., None] * (source[3] - source[0])
            out.append(np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]],
                                axis=2).reshape(-1, 4, source.shape[-1]))
    return np.concatenate(out_corners), np.concatenate(out_uv)


def _smoothed(corners: Array, normal: Array) -> Array:
    """(Q, 4, 3) corner normals: the mean over the faces there that turn by less than 35 degrees."""
    points = np.round(corners.reshape(-1, 3) / 1e-5).astype(np.int64)
    _, where = np.unique(points, axis=0, return_inverse=True)
    where, face = where.reshape(-1), np.repeat(np.arange(len(corners)), 4)
    meets = (where[:, None] == where[None, :]) & (
        normal[face] @ normal[face].T > np.cos(np.deg2rad(35.0)))
    total = meets @ normal[face]
    total = total / np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total).reshape(-1, 4, 3)
