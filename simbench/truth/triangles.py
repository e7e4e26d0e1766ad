"""All boxes, planes and meshes of a scene as triangles, and rays of one camera against them.

Millions of rays a second: the triangles are sorted into tiles of the image, so that a ray meets
the few of its own tile only. All is exact in float64; no image is involved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numba
import numpy as np

from simbench.render.geometry import geom_triangles, shown_geoms
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

DRAWN_AS_TRIANGLES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX,
                      mujoco.mjtGeom.mjGEOM_MESH)
_ENDLESS_M = 1e4    # half the size of a plane that the model says is endless
_TILE_PX = 8
_AHEAD_M = 1e-6     # triangles with a corner nearer than this have no rectangle in the image
_LEVEL = 1e-9       # an edge that rises less than this across a pixel runs along the rows
_EDGE_PX = 1e-9     # so that no ray slips between two triangles


class Triangles(NamedTuple):
    vertices_part: Array    # (V, 3) m, in the frame of their part
    faces: Array            # (F, 3) int, counter-clockwise from outside
    first: Array            # (P + 1,) part p has the vertices first[p] to first[p + 1]


def triangles_of(model: Any) -> Triangles:
    """The triangles of every drawn box, plane and mesh of a compiled model."""
    geoms = [geom for geom in shown_geoms(model).tolist()
             if int(model.geom_type[geom]) in DRAWN_AS_TRIANGLES]
    geoms.sort(key=lambda geom: int(model.geom_bodyid[geom]))
    vertices, faces, counts = [np.empty((0, 3))], [np.empty((0, 3), np.intp)], 0
    per_part = np.zeros(model.nbody, np.intp)
    for geom in geoms:
        v, f = geom_triangles(model, geom, _ENDLESS_M)
        R = se3.rotation_from_quaternion(np.roll(model.geom_quat[geom], -1))
        vertices.append(v @ R.T + model.geom_pos[geom])
        faces.append(f.astype(np.intp) + counts)
        counts += len(v)
        per_part[model.geom_bodyid[geom]] += len(v)
    return Triangles(np.concatenate(vertices), np.concatenate(faces),
                     np.concatenate([[0], np.cumsum(per_part)]))


@dataclass(frozen=True, slots=True)
class Screen:
    """The triangles that face one camera at one instant, by the tiles of its image they touch.

    Coefficients are (3, F): their value at a pixel is c[0] u + c[1] v + c[2].
    """

    plane: Array                        # inverse depth on the triangle's plane
    edges: tuple[Array, Array, Array]   # px inward of each edge: a ray hits where none is negative
    by_tile: Array                      # triangles, tile after tile
    first: Array                        # (tiles + 1,) tile t has by_tile[first[t]:first[t + 1]]
    across: int                         # tiles side by side
    down: int                           # tiles above each other

    def anything_before(self, uv: Array, inverse_depth: Array) -> Array:
        """(N,) bool: rays through pixels (N, 2) hit something nearer than this (N,)."""
        return _any_before(np.ascontiguousarray(uv, np.float64), inverse_depth, self.plane,
                           *self.edges, self.by_tile, self.first, self.across, self.down)


@numba.njit(cache=True)
def _any_before(uv: Array, inverse_depth: Array, plane: Array, edge_0: Array, edge_1: Array,
                edge_2: Array, by_tile: Array, first: Array, across: int, down: int) -> Array:
    hit = np.zeros(len(uv), np.bool_)
    for ray in range(len(uv)):
        u, v = uv[ray]
        column = min(max(int(np.floor((u + 0.5) / _TILE_PX)), 0), across - 1)
        row = min(max(int(np.floor((v + 0.5) / _TILE_PX)), 0), down - 1)
        tile = row * across + column
        for place in range(first[tile], first[tile + 1]):
            t = by_tile[place]
            if (_value(plane, t, u, v) > inverse_depth[ray] and _value(edge_0, t, u, v) >= -_EDGE_PX
                    and _value(edge_1, t, u, v) >= -_EDGE_PX
                    and _value(edge_2, t, u, v) >= -_EDGE_PX):
                hit[ray] = True
                break
    return hit


@numba.njit(cache=True, inline="always")
def _value(coefficients: Array, triangle: int, u: float, v: float) -> float:
    """Coefficients (3, F) of one triangle at a pixel."""
    return (coefficients[0, triangle] * u + coefficients[1, triangle] * v
            + coefficients[2, triangle])


def screen_of(triangles: Triangles, T_world_part: Array, T_world_camera: Array,
              intrinsics: Intrinsics) -> Screen:
    """What stands before a camera (OpenCV axes), with the parts where they are said to be."""
    vertices = _vertices_in_camera(triangles, se3.inverse(T_world_camera) @ T_world_part)
    kept, box = _in_view(vertices, triangles.faces, intrinsics)
    a, b, c = vertices[triangles.faces[kept].T]
    normal = np.cross(b - a, c - a)
    height = np.sum(normal * a, axis=-1)   # negative: its outside turns to the camera
    facing = height < 0.0
    a, b, c, normal, height = a[facing], b[facing], c[facing], normal[facing], height[facing]
    inverse_K = np.linalg.inv(intrinsics.matrix)
    plane = np.ascontiguousarray((normal / height[:, None] @ inverse_K).T)
    edges = (_edge(b, a, inverse_K), _edge(c, b, inverse_K), _edge(a, c, inverse_K))
    across, down = -(-intrinsics.width // _TILE_PX), -(-intrinsics.height // _TILE_PX)
    by_tile, first = _tiles(box[:, facing], edges, across, down)
    return Screen(plane, edges, by_tile, first, across, down)


def _vertices_in_camera(triangles: Triangles, T_camera_part: Array) -> Array:
    """(V, 3) m."""
    vertices = np.empty_like(triangles.vertices_part)
    for part in np.flatnonzero(np.diff(triangles.first)).tolist():
        own = slice(triangles.first[part], triangles.first[part + 1])
        vertices[own] = se3.transform_points(T_camera_part[part], triangles.vertices_part[own])
    return vertices


def _in_view(vertices: Array, faces: Array, intrinsics: Intrinsics) -> tuple[Array, Array]:
    """(M,) the triangles that may be seen, and (4, M) u_min, v_min, u_max, v_max around each.

    All the image stands for the rectangle of a triangle that is not ahead with all its corners.
    """
    x, y, z = vertices.T
    ahead = z > _AHEAD_M
    safe = np.where(ahead, z, 1.0)
    u = np.where(ahead, intrinsics.fx * x / safe + intrinsics.cx, np.nan)
    v = np.where(ahead, intrinsics.fy * y / safe + intrinsics.cy, np.nan)
    f0, f1, f2 = faces.T
    u0, u1, u2, v0, v1, v2 = u[f0], u[f1], u[f2], v[f0], v[f1], v[f2]
    box = np.stack([np.minimum(np.minimum(u0, u1), u2), np.minimum(np.minimum(v0, v1), v2),
                    np.maximum(np.maximum(u0, u1), u2), np.maximum(np.maximum(v0, v1), v2)])
    partly = np.isnan(box[0]) & (ahead[f0] | ahead[f1] | ahead[f2])
    right, bottom = intrinsics.width - 0.5, intrinsics.height - 0.5
    box[:, partly] = np.array([[-0.5], [-0.5], [right], [bottom]])
    kept = np.flatnonzero((box[0] <= right) & (box[2] >= -0.5)
                          & (box[1] <= bottom) & (box[3] >= -0.5))
    return kept, box[:, kept]


def _edge(start: Array, stop: Array, inverse_K: Array) -> Array:
    """(3, F) coefficients of the distance in px inward of the edge between corners (F, 3)."""
    line = np.cross(start, stop) @ inverse_K
    line /= np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-300)[:, None]
    return np.ascontiguousarray(line.T)


def _tiles(box: Array, edges: tuple[Array, Array, Array], across: int, down: int
           ) -> tuple[Array, Array]:
    """Triangles tile after tile, and where each tile begins.

    In every row of tiles a triangle touches those between two columns: where each of its edges,
    taken at the row's upper or lower border, whichever is further inward, is not negative.
    """
    v0, v1 = (np.floor((v + 0.5) / _TILE_PX).clip(0, down - 1).astype(np.intp) for v in box[1::2])
    triangle, row = _ranges(v0, v1)
    left, right = box[0].take(triangle), box[2].take(triangle)
    upper = row * float(_TILE_PX) - 0.5
    for edge in edges:
        along_u, along_v, constant = (c.take(triangle) for c in edge)
        inward = constant + along_v * upper + np.maximum(along_v, 0.0) * _TILE_PX + _EDGE_PX
        level = np.abs(along_u) < _LEVEL
        crossing = -inward / np.where(level, 1.0, along_u)
        np.maximum(left, crossing, out=left, where=along_u >= _LEVEL)
        np.minimum(right, crossing, out=right, where=along_u <= -_LEVEL)
        right[level & (inward < 0.0)] = -np.inf
    u0 = np.floor((left + 0.5) / _TILE_PX).clip(0, across - 1).astype(np.intp)
    u1 = np.floor((right + 0.5) / _TILE_PX).clip(-1, across - 1).astype(np.intp)
    u1[right < left] = -1
    entry, column = _ranges(u0, np.maximum(u1, u0 - 1))
    tile = row.take(entry) * across + column
    first = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=across * down))])
    return triangle.take(entry)[np.argsort(tile, kind="stable")], first


def _ranges(start: Array, stop: Array) -> tuple[Array, Array]:
    """All integers of N ranges, both ends within: the range of each (M,), and the integer (M,)."""
    count = stop - start + 1
    number = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return number, np.arange(len(number)) + np.repeat(start - before, count)
