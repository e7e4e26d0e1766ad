"""All boxes, planes and meshes of a scene as triangles, and rays of one camera against them.

Millions of rays a second from NumPy: the triangles are sorted into tiles of the image, so that a
ray meets the few of its own tile only. All is exact in float64; no image is involved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from simbench.render.geometry import geom_triangles, shown_geoms
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

DRAWN_AS_TRIANGLES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_BOX,
                      mujoco.mjtGeom.mjGEOM_MESH)
_ENDLESS_M = 1e4    # half the size of a plane that the model says is endless
_TILE_PX = 16
_AHEAD_M = 1e-6     # triangles with a corner nearer than this have no rectangle in the image
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
    """The triangles that face one camera at one instant, by the tiles of its image they touch."""

    plane: Array         # (F, 3): inverse depth on the triangle's plane is plane · (u, v, 1)
    edges: Array         # (F, 3, 3): a ray hits where all three edges · (u, v, 1) are ≥ 0
    by_tile: Array       # triangles, tile after tile
    first: Array         # (tiles + 1,) tile t has by_tile[first[t]:first[t + 1]]
    across: int          # tiles side by side
    down: int            # tiles above each other

    def anything_before(self, uv: Array, inverse_depth: Array) -> Array:
        """(N,) bool: rays through pixels (N, 2) hit something nearer than this (N,)."""
        column, row = np.floor((uv + 0.5) / _TILE_PX).astype(np.intp).T
        column, row = np.clip(column, 0, self.across - 1), np.clip(row, 0, self.down - 1)
        tile = row * self.across + column
        count = self.first[tile + 1] - self.first[tile]
        ray = np.repeat(np.arange(len(uv)), count)
        before = np.cumsum(count) - count
        triangle = self.by_tile[np.arange(len(ray)) - before[ray] + self.first[tile][ray]]
        p = np.concatenate([uv[ray], np.ones((len(ray), 1))], axis=1)
        keep = np.einsum("nk,nk->n", self.plane[triangle], p) > inverse_depth[ray]
        ray, triangle, p = ray[keep], triangle[keep], p[keep]
        inside = np.all(np.einsum("nek,nk->ne", self.edges[triangle], p) >= -_EDGE_PX, axis=-1)
        hit = np.zeros(len(uv), bool)
        hit[ray[inside]] = True
        return hit


def screen_of(triangles: Triangles, T_world_part: Array, T_world_camera: Array,
              intrinsics: Intrinsics) -> Screen:
    """What stands before a camera (OpenCV axes), with the parts where they are said to be."""
    corners = _corners_in_camera(triangles, se3.inverse(T_world_camera) @ T_world_part)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    height = np.einsum("fk,fk->f", normal, a)   # negative: its outside turns to the camera
    box = _rectangles(corners, intrinsics)
    shown = (height < 0.0) & (corners[..., 2].max(axis=1) > 0.0)
    shown &= (box[:, 0] <= intrinsics.width - 0.5) & (box[:, 2] >= -0.5)
    shown &= (box[:, 1] <= intrinsics.height - 0.5) & (box[:, 3] >= -0.5)
    a, b, c, height, box = a[shown], b[shown], c[shown], height[shown], box[shown]
    inverse_K = np.linalg.inv(intrinsics.matrix)
    edges = np.stack([np.cross(b, a), np.cross(c, b), np.cross(a, c)], axis=1) @ inverse_K
    edges /= np.maximum(np.linalg.norm(edges[..., :2], axis=-1, keepdims=True), 1e-300)
    plane = (normal[shown] / height[:, None]) @ inverse_K
    across, down = -(-intrinsics.width // _TILE_PX), -(-intrinsics.height // _TILE_PX)
    by_tile, first = _tiles(box, edges, across, down)
    return Screen(plane, edges, by_tile, first, across, down)


def _corners_in_camera(triangles: Triangles, T_camera_part: Array) -> Array:
    """(F, 3, 3) the corners of every triangle."""
    vertices = np.empty_like(triangles.vertices_part)
    for part in np.flatnonzero(np.diff(triangles.first)).tolist():
        own = slice(triangles.first[part], triangles.first[part + 1])
        vertices[own] = se3.transform_points(T_camera_part[part], triangles.vertices_part[own])
    return vertices[triangles.faces]


def _rectangles(corners: Array, intrinsics: Intrinsics) -> Array:
    """(F, 4) smallest rectangle around each triangle; all the image where a corner is not ahead."""
    ahead = corners[..., 2].min(axis=1) > _AHEAD_M
    z = np.where(ahead[:, None], corners[..., 2], 1.0)
    u = intrinsics.fx * corners[..., 0] / z + intrinsics.cx
    v = intrinsics.fy * corners[..., 1] / z + intrinsics.cy
    box = np.stack([u.min(1), v.min(1), u.max(1), v.max(1)], axis=-1)
    box[~ahead] = (-0.5, -0.5, intrinsics.width - 0.5, intrinsics.height - 0.5)
    return box + np.array([-1.0, -1.0, 1.0, 1.0]) * _EDGE_PX


def _tiles(box: Array, edges: Array, across: int, down: int) -> tuple[Array, Array]:
    """Triangles tile after tile, and where each tile begins."""
    limit = np.array([across, down, across, down]) - 1
    u0, v0, u1, v1 = np.clip(np.floor((box + 0.5) / _TILE_PX), 0, limit).astype(np.intp).T
    wide = u1 - u0 + 1
    count = wide * (v1 - v0 + 1)
    triangle = np.repeat(np.arange(len(box)), count)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(within, wide[triangle])
    row, column = row + v0[triangle], column + u0[triangle]
    # A tile lies outside of an edge when even its corner furthest inward does.
    half = 0.5 * _TILE_PX
    touched = np.ones(len(triangle), bool)
    for edge in range(3):
        along_u, along_v, constant = edges[:, edge].T
        inward = constant + half * (np.abs(along_u) + np.abs(along_v)) + _EDGE_PX
        inward += (half - 0.5) * (along_u + along_v)
        touched &= (along_u[triangle] * (_TILE_PX * column) + along_v[triangle] * (_TILE_PX * row)
                    + inward[triangle] >= 0.0)
    triangle, tile = triangle[touched], (row * across + column)[touched]
    first = np.concatenate([[0], np.cumsum(np.bincount(tile, minlength=across * down))])
    return triangle[np.argsort(tile, kind="stable")], first
