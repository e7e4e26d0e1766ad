"""The straight 3D edges of a compiled MuJoCo model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection

import mujoco
import numpy as np

from simbench.types import Edges3D
from slam.geometry import se3
from slam.geometry.arrays import Array

_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_BOX_EDGES = np.array([(a, b) for a in range(8) for b in range(a + 1, 8)
                       if np.count_nonzero(_BOX_CORNERS[a] != _BOX_CORNERS[b]) == 1])

THINNEST_M = 0.012     # the long edges of thinner rods cannot be told apart
_CREASE_COS = np.cos(np.deg2rad(30.0))
_WELD_M = 1e-5         # mesh vertices are float32: equal corners differ by less than this
_SAME_LINE = 1e-3      # rounding of direction and foot (m) by which edges share a line


def model_edges(model: mujoco.MjModel, shortest_m: float = 0.1, edgeless: Collection[str] = ()
                ) -> Edges3D:
    """The edges of every visible box and mesh geom, in the frame of its body (part).

    A box has twelve. A mesh has those where two faces meet at more than 30 degrees or where its
    surface ends. Collinear pieces on one part are joined. Planes, curved primitives and geoms
    whose material is named in `edgeless` have none.
    """
    skipped = {model.material(name).id for name in edgeless}
    of_part: dict[int, list[Array]] = defaultdict(list)
    for geom in range(model.ngeom):
        if model.geom_group[geom] > 2 or int(model.geom_matid[geom]) in skipped:
            continue
        kind = model.geom_type[geom]
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            local = _box_edges(model.geom_size[geom])
        elif kind == mujoco.mjtGeom.mjGEOM_MESH:
            local = _mesh_edges(*mesh_triangles(model, int(model.geom_dataid[geom])))
        else:
            continue
        T_part_geom = se3.from_rotation_translation(
            se3.rotation_from_quaternion(np.roll(model.geom_quat[geom], -1)), model.geom_pos[geom])
        of_part[int(model.geom_bodyid[geom])].append(se3.transform_points(T_part_geom, local))
    parts, ends = [np.zeros(0, np.int32)], [np.zeros((0, 2, 3))]
    for part in sorted(of_part):
        joined = _joined(np.concatenate(of_part[part]))
        joined = joined[np.linalg.norm(joined[:, 1] - joined[:, 0], axis=1) >= shortest_m]
        ends.append(joined)
        parts.append(np.full(len(joined), part, np.int32))
    return Edges3D(np.concatenate(parts), np.concatenate(ends))


def mesh_triangles(model: mujoco.MjModel, mesh: int) -> tuple[Array, Array]:
    """Vertices (V, 3) float64 and faces (F, 3) of a compiled mesh, in its geom's frame."""
    v0, f0 = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[v0:v0 + model.mesh_vertnum[mesh]].astype(np.float64)
    return vertices, model.mesh_face[f0:f0 + model.mesh_facenum[mesh]]


def _box_edges(half_size: Array) -> Array:
    """(12, 2, 3), or none of a thin rod."""
    if np.sort(half_size)[1] * 2.0 < THINNEST_M:
        return np.zeros((0, 2, 3))
    return np.asarray((_BOX_CORNERS * half_size)[_BOX_EDGES])


def _mesh_edges(vertices: Array, faces: Array) -> Array:
    """(E, 2, 3) crease and boundary edges of a triangle mesh."""
    _, first, weld = np.unique(np.round(vertices / _WELD_M).astype(np.int64), axis=0,
                               return_index=True, return_inverse=True)
    points, faces = vertices[first], weld.reshape(-1)[faces]
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    keep = area > 1e-12
    faces, normal = faces[keep], normal[keep] / area[keep, None]
    pair = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    face_normal = np.repeat(normal, 3, axis=0)
    edges, edge = np.unique(pair, axis=0, return_inverse=True)
    edge = edge.reshape(-1)
    uses = np.bincount(edge, minlength=len(edges))
    # Two unit normals sum to a vector of length² 2 + 2 cos.
    total = np.stack([np.bincount(edge, weights=face_normal[:, k], minlength=len(edges))
                      for k in range(3)], axis=-1)
    flat = (uses == 2) & (np.sum(total**2, axis=1) > 2.0 + 2.0 * _CREASE_COS)
    return np.asarray(points[edges[~flat]])


def _joined(segments: Array) -> Array:
    """Segments (E, 2, 3) with touching or overlapping collinear ones made one."""
    if len(segments) == 0:
        return segments
    direction = segments[:, 1] - segments[:, 0]
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    # Of the two directions of a line take the one whose first clear component is positive.
    lead = np.argmax(np.abs(direction) > _SAME_LINE, axis=1)
    direction *= np.sign(np.take_along_axis(direction, lead[:, None], axis=1))
    along = np.einsum("esk,ek->es", segments, direction)
    foot = segments[:, 0] - along[:, :1] * direction
    # The odd offset keeps round numbers off the borders between rounding cells.
    key = np.floor(np.concatenate([direction, foot], axis=1) / _SAME_LINE + 0.37).astype(np.int64)
    _, line = np.unique(key, axis=0, return_inverse=True)
    line = line.reshape(-1)
    low, high = along.min(axis=1), along.max(axis=1)
    order = np.lexsort((low, line))
    line, low, high, direction, foot = (x[order] for x in (line, low, high, direction, foot))
    # The furthest end so far on the same line: lines are set apart by more than any coordinate.
    apart = line * (4.0 * (np.abs(along).max() + 1.0))
    reach = np.maximum.accumulate(high + apart)
    starts = np.ones(len(line), bool)
    starts[1:] = (low + apart)[1:] > reach[:-1] + _SAME_LINE
    begin = np.flatnonzero(starts)
    last = np.maximum.reduceat(high, begin)
    return np.stack([foot[begin] + low[begin, None] * direction[begin],
                     foot[begin] + last[:, None] * direction[begin]], axis=1)
