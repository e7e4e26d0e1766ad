"""Local mapping: keyframes, new landmarks, culling, the local bundle adjustment."""

from __future__ import annotations

import numpy as np

from slam.dpl.adjust import adjust
from slam.dpl.config import DplConfig
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.landmarks import Landmarks
from slam.dpl.observers import Observers
from slam.dpl.track import TrackedFrame
from slam.dpl.triangulate import triangulate_pairs
from slam.dpl.triangulate_lines import triangulate_line_pairs
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project, project
from slam.geometry.segment import unit_normals
from slam.types import Intrinsics

_YOUNG = 3               # keyframes during which a landmark must prove itself
_PARTNERS = 3            # neighbours with which features without depth are triangulated
_HOLDERS = 3             # other keyframes in which a point is seen often


class LocalMapper:
    """Adds keyframes to a map and keeps it clean."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config

    def insert(self, map_: PointLineMap, frame: int, tracked: TrackedFrame) -> Keyframe:
        """A new keyframe with landmarks for what it alone sees; the map around it is adjusted."""
        keyframe = map_.add_keyframe(frame, tracked.T_world_camera, tracked.features,
                                     tracked.point_of, tracked.line_of)
        self._cull_landmarks(map_, keyframe.number)
        self._add_points(map_, keyframe)
        self._add_lines(map_, keyframe)
        neighbours = map_.neighbours(keyframe, self.config.mapping.window - 1)
        for triangulate in (triangulate_pairs, triangulate_line_pairs):
            triangulate(map_, keyframe, neighbours[:_PARTNERS], self.camera, self.config)
        self.adjust_around(map_, keyframe)
        self._choose_references(map_, keyframe)
        self._cull_keyframes(map_, neighbours)
        return keyframe

    def adjust_around(self, map_: PointLineMap, keyframe: Keyframe) -> None:
        """Local bundle adjustment: the keyframe and its neighbours move, theirs hold them."""
        c = self.config.mapping
        free = [keyframe, *map_.neighbours(keyframe, c.window - 1)]
        if len(free) < 2:
            return
        points, lines = map_.landmarks_of(free)
        shared = map_.covisible(points, lines)
        shared[[k.number for k in free]] = 0
        best = np.argsort(-shared, kind="stable")[:c.fixed]
        fixed = [map_.keyframes[i] for i in best if shared[i] > 0]
        if not fixed:
            oldest = min(free, key=lambda k: k.number)
            free, fixed = [k for k in free if k is not oldest], [oldest]
        adjust(map_, free, fixed, self.camera, self.config, c.iterations)

    def _add_points(self, map_: PointLineMap, keyframe: Keyframe) -> None:
        points = keyframe.features.points
        new = np.flatnonzero((keyframe.point_of < 0) & (points.depth_m > 0)
                             & (points.depth_m < self.config.depth.max_m))
        T = keyframe.T_world_camera
        xyz = se3.transform_points(T, back_project(self.camera, points.uv_px[new],
                                                   points.depth_m[new]))
        point_of = keyframe.point_of.copy()
        point_of[new] = map_.points.add(xyz[:, None], points.descriptor[new], points.level[new],
                                        T[:3, 3], keyframe.number)
        map_.see_points(keyframe, point_of)

    def _add_lines(self, map_: PointLineMap, keyframe: Keyframe) -> None:
        lines = keyframe.features.lines
        known = ((lines.depth_m > 0) & (lines.depth_m < self.config.depth.max_m)).all(axis=1)
        new = np.flatnonzero((keyframe.line_of < 0) & known)
        T = keyframe.T_world_camera
        ends = se3.transform_points(T, back_project(
            self.camera, lines.ends_px[new], lines.depth_m[new]).reshape(-1, 3)).reshape(-1, 2, 3)
        line_of = keyframe.line_of.copy()
        line_of[new] = map_.lines.add(ends, lines.descriptor[new], np.zeros(len(new), np.int32),
                                      T[:3, 3], keyframe.number)
        map_.see_lines(keyframe, line_of)

    def _cull_landmarks(self, map_: PointLineMap, now: int) -> None:
        """Landmarks that are seldom found where they should be seen, or seen once only, go."""
        map_.forget_landmarks(self._unproven(map_.points, map_.point_observers, now),
                              self._unproven(map_.lines, map_.line_observers, now))

    def _unproven(self, table: Landmarks, observers: Observers, now: int) -> Array:
        """(N,) rows of the landmarks that go."""
        seldom = table.found < self.config.mapping.min_found_share * table.visible
        tried = np.flatnonzero(table.alive & (now - table.born == _YOUNG))
        lonely = tried[observers.count(tried) < 2]
        return np.union1d(np.flatnonzero(table.alive & seldom), lonely)

    def _choose_references(self, map_: PointLineMap, keyframe: Keyframe) -> None:
        """Reference keyframes of map lines: whoever sees the line widest and fits it well."""
        rows = keyframe.line_of[keyframe.line_of >= 0]
        if not len(rows):
            return
        lines = map_.lines
        score = self._line_views(map_, keyframe, rows)
        holder = lines.reference[rows]
        other = np.zeros(len(rows))
        for number in np.unique(holder):
            mine = holder == number
            other[mine] = self._line_views(map_, map_.keyframes[number], rows[mine])
        lines.reference[rows[score > other]] = keyframe.number

    def _line_views(self, map_: PointLineMap, keyframe: Keyframe, rows: Array) -> Array:
        """(N,) how well a keyframe sees lines: the angle they fill, less the more they misfit.

        Breadth of view is the angle (rad) under which the line is seen; a misfit of one standard
        deviation in pixels halves it.
        """
        centre = keyframe.T_world_camera[:3, 3]
        to = map_.lines.xyz[rows] - centre
        to = to / np.maximum(np.linalg.norm(to, axis=2, keepdims=True), 1e-9)
        breadth = np.arccos(np.clip(np.sum(to[:, 0] * to[:, 1], axis=1), -1.0, 1.0))
        feature = np.full(map_.lines.count + 1, -1, np.int64)
        seen = np.flatnonzero(keyframe.line_of >= 0)
        feature[keyframe.line_of[seen]] = seen
        known = np.flatnonzero(feature[rows] >= 0)       # none of a keyframe that is gone
        misfit = line_misfit_px(map_.lines.xyz[rows[known]],
                                keyframe.features.lines.ends_px[feature[rows[known]]],
                                keyframe.T_world_camera, self.camera)
        out = np.zeros(len(rows))
        out[known] = breadth[known] / (1.0 + (misfit / self.config.track.line_sigma_px) ** 2)
        return out

    def _cull_keyframes(self, map_: PointLineMap, neighbours: list[Keyframe]) -> None:
        """Neighbours whose points are nearly all seen by three others go."""
        for keyframe in neighbours:
            rows = keyframe.point_of[keyframe.point_of >= 0]
            if keyframe.number == 0 or not len(rows):
                continue
            seen_often = map_.point_observers.count(rows) > _HOLDERS
            if np.mean(seen_often) > self.config.mapping.redundant_share:
                map_.drop_keyframe(keyframe)


def line_misfit_px(ends_world: Array, ends_px: Array, T_world_camera: Array,
                   camera: Intrinsics) -> Array:
    """(N,) mean distance of the projected ends (N, 2, 3) from the seen segments' lines."""
    xyz = se3.transform_points(se3.inverse(T_world_camera), ends_world.reshape(-1, 3))
    uv = project(camera, xyz).reshape(-1, 2, 2)
    normal = unit_normals(ends_px)[:, None]
    gap = np.abs(np.sum((uv - ends_px[:, :1]) * normal, axis=2)).mean(axis=1)
    return np.where(np.isfinite(gap), gap, np.inf)
