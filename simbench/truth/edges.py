"""The visible stretches of the scene's straight edges in one frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from simbench.truth.rays import Hides, RayCaster
from simbench.types import FrameTruth, SceneLayout, VisibleEdges
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

NEAR_M = 0.05          # edges are cut where they come nearer to the camera than this
MIN_LENGTH_PX = 5.0    # shorter stretches are no segments to anybody
_STEP_PX = 2.0         # visibility is sampled this finely ...
_HALVINGS = 6          # ... and each end of a stretch is then found to 1/32 px
_OFFSET_M = 1e-3       # an edge stands this far before its own faces


class _Clipped(NamedTuple):
    edge: Array     # (S,) int
    camera: Array   # (S, 2, 3) m: ends within the image and before the near plane


def visible_edges(truth: FrameTruth, layout: SceneLayout, caster: RayCaster,
                  min_length_px: float = MIN_LENGTH_PX) -> VisibleEdges:
    """Clip every edge to the image, and cut it where something stands before it.

    Args:
        min_length_px: shorter stretches are left out.
    """
    clipped = _clip(_in_camera(truth, layout), layout.intrinsics)
    hides = caster.hides(truth, layout.intrinsics)
    stretches, row = _stretches(clipped, layout.intrinsics, hides)
    ends_camera = _points_at(clipped.camera[row], stretches)
    ends_px = _pixels(ends_camera, layout.intrinsics)[..., :2]
    long = np.linalg.norm(ends_px[:, 1] - ends_px[:, 0], axis=-1) >= min_length_px
    edge = clipped.edge[row[long]].astype(np.int32)
    return VisibleEdges(
        edge=edge, endpoints_px=ends_px[long], endpoints_camera=ends_camera[long],
        instance_id=layout.instance_of_part[layout.edges.part_id[edge]].astype(np.int32))


def _in_camera(truth: FrameTruth, layout: SceneLayout) -> Array:
    """(E, 2, 3) endpoints in the camera's frame."""
    T_camera_part = se3.inverse(truth.T_world_camera) @ truth.T_world_part
    return se3.transform_points(T_camera_part[layout.edges.part_id], layout.edges.endpoints_part)


def _clip(ends: Array, intrinsics: Intrinsics) -> _Clipped:
    """Cut edges (E, 2, 3) to what lies in the image and before the near plane (Liang–Barsky)."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    inward = np.array([
        [fx, 0.0, cx + 0.5], [-fx, 0.0, intrinsics.width - 0.5 - cx],
        [0.0, fy, cy + 0.5], [0.0, -fy, intrinsics.height - 0.5 - cy], [0.0, 0.0, 1.0]])
    distance = ends @ inward.T - np.array([0.0, 0.0, 0.0, 0.0, NEAR_M])     # (E, 2, 5)
    start, stop = distance[:, 0], distance[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start / (start - stop)
    enter = np.max(np.where((start < 0.0) & (stop >= 0.0), crossing, 0.0), axis=-1)
    leave = np.min(np.where((start >= 0.0) & (stop < 0.0), crossing, 1.0), axis=-1)
    kept = (enter < leave) & ~np.any((start < 0.0) & (stop < 0.0), axis=-1)
    t = np.stack([enter, leave], axis=-1)[kept]
    a, b = ends[kept, :1], ends[kept, 1:]
    return _Clipped(np.flatnonzero(kept), a + t[..., None] * (b - a))


def _pixels(points: Array, intrinsics: Intrinsics) -> Array:
    """Points (..., 3) in the camera to (..., 3): pixel and z-depth."""
    z = points[..., 2]
    return np.stack([intrinsics.fx * points[..., 0] / z + intrinsics.cx,
                     intrinsics.fy * points[..., 1] / z + intrinsics.cy, z], axis=-1)


def _points_at(ends: Array, s: Array) -> Array:
    """Points (S, M, 3) of edges (S, 2, 3) at shares s (S, M) of their length in the IMAGE.

    Inverse depth runs linearly along the image: t = s z₀ / (s z₀ + (1 − s) z₁).
    """
    z = ends[..., 2]
    near, far = s * z[:, :1], (1.0 - s) * z[:, 1:]
    t = (near / (near + far))[..., None]
    return ends[:, :1] + t * (ends[:, 1:] - ends[:, :1])


def _stretches(clipped: _Clipped, intrinsics: Intrinsics, hides: Hides) -> tuple[Array, Array]:
    """Visible stretches as shares of the clipped edge in the image (V, 2), and its row (V,)."""
    def visible(row: Array, s: Array) -> Array:
        points = _points_at(clipped.camera[row], s[:, None])[:, 0]
        points = points * (1.0 - _OFFSET_M / np.linalg.norm(points, axis=-1, keepdims=True))
        return ~hides(_pixels(points, intrinsics))

    pixels = _pixels(clipped.camera, intrinsics)[..., :2]
    steps = np.ceil(np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=-1) / _STEP_PX).astype(int)
    steps = np.maximum(steps, 1)
    row = np.repeat(np.arange(len(steps)), steps + 1)
    first = np.cumsum(steps + 1) - (steps + 1)
    s = (np.arange(len(row)) - first[row]) / steps[row]
    seen = visible(row, s)
    before = np.r_[False, seen[:-1] & (row[1:] == row[:-1])]
    after = np.r_[seen[1:] & (row[1:] == row[:-1]), False]
    starts, stops = np.flatnonzero(seen & ~before), np.flatnonzero(seen & ~after)
    step = 1.0 / steps[row]
    begin = _refined(visible, row[starts], s[starts], -step[starts])
    end = _refined(visible, row[stops], s[stops], step[stops])
    return np.stack([begin, end], axis=-1), row[starts]


def _refined(visible: Callable[[Array, Array], Array], row: Array, s: Array, step: Array) -> Array:
    """The last visible share between s (visible) and s + step (hidden), by halving; within 0..1."""
    at_end = (s + step < -1e-9) | (s + step > 1.0 + 1e-9)
    inner, outer = s.copy(), np.where(at_end, s, s + step)
    for _ in range(_HALVINGS):
        middle = 0.5 * (inner + outer)
        seen = visible(row, middle)
        inner, outer = np.where(seen, middle, inner), np.where(seen, outer, middle)
    return inner
