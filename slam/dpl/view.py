"""Where landmarks should be seen from a pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam.dpl.landmarks import Landmarks
from slam.frontend.sampling import inside
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import project
from slam.types import Intrinsics

_MIN_COSINE = 0.5        # between the first view's direction and this one's: 60°
_NEAR_M = 0.05           # ends of lines are cut off here, in front of the camera


class PointsInView(NamedTuple):
    rows: Array          # (M,) of the landmarks
    uv_px: Array         # (M, 2)
    level: Array         # (M,) int32 pyramid level at which each should be found


def points_in_view(points: Landmarks, rows: Array, T_world_camera: Array, camera: Intrinsics,
                   scale: float, levels: int) -> PointsInView:
    """Those of the landmarks that this pose should see, by place, direction and size."""
    xyz = points.xyz[rows, 0]
    uv = project(camera, se3.transform_points(se3.inverse(T_world_camera), xyz))
    away = T_world_camera[:3, 3] - xyz
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    cosine = np.sum(away * points.normal[rows], axis=1) / distance
    level = points.level_at(rows, distance, scale)
    with np.errstate(invalid="ignore"):
        seen = (inside(uv, (camera.height, camera.width)) & (cosine > _MIN_COSINE)
                & (level > -1.5) & (level < levels + 0.5))
    return PointsInView(rows[seen], uv[seen], whole_level(level[seen], levels))


def whole_level(level: Array, levels: int) -> Array:
    """(N,) int32 the nearest of the pyramid's levels."""
    return np.asarray(np.clip(np.rint(level), 0, levels - 1).astype(np.int32))


class LinesInView(NamedTuple):
    rows: Array          # (M,) of the landmarks
    ends_px: Array       # (M, 2, 2), beyond the image's border where the line goes on there


def lines_in_view(lines: Landmarks, rows: Array, T_world_camera: Array,
                  camera: Intrinsics) -> LinesInView:
    """Those of the map lines of which this pose should see a part."""
    ends = se3.transform_points(se3.inverse(T_world_camera), lines.xyz[rows].reshape(-1, 3))
    ends = cut_at(ends.reshape(-1, 2, 3), _NEAR_M)
    uv = project(camera, ends)
    t = np.linspace(0.0, 1.0, 5)[:, None]
    samples = uv[:, None, 0] * (1 - t) + uv[:, None, 1] * t              # (M, 5, 2)
    with np.errstate(invalid="ignore"):
        seen = inside(samples, (camera.height, camera.width)).sum(axis=1) >= 2
    return LinesInView(rows[seen], uv[seen])


def cut_at(ends: Array, near_m: float) -> Array:
    """Segments (N, 2, 3) without what lies nearer to the camera's plane than `near_m`.

    A segment that lies there whole stays, and has no image.
    """
    z = ends[:, :, 2]
    behind: Array = np.asarray(z < near_m)
    one = np.asarray(behind.any(axis=1) & ~behind.all(axis=1))
    step = np.where(one, z[:, 1] - z[:, 0], 1.0)
    share = np.where(one, (near_m - z[:, 0]) / step, 0.0)[:, None]
    crossing = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
    return np.where((behind & one[:, None])[:, :, None], crossing[:, None], ends)
