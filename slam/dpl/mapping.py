"""Local mapping: keyframes, new landmarks, culling, the local bundle adjustment."""

from __future__ import annotations

import numpy as np

from slam.dpl.adjust import adjust
from slam.dpl.config import DplConfig
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.landmarks import Landmarks
from slam.dpl.track import TrackedFrame
from slam.dpl.triangulate import triangulate_pairs
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project, project
from slam.types import Intrinsics

_YOUNG = 3               # keyframes during which a landmark must prove itself


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
        triangulate_pairs(map_, keyframe, neighbours[:3], self.camera, self.config)
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
        keyframe.point_of[new] = map_.points.add(xyz[:, None], points.descriptor[new],
                                                 points.level[new], T[:3, 3], keyframe.number)

    def _add_lines(self, map_: PointLineMap, keyframe: Keyframe) -> None:
        lines = keyframe.features.lines
        known = ((lines.depth_m > 0) & (lines.depth_m < self.config.depth.max_m)).all(axis=1)
        new = np.flatnonzero((keyframe.line_of < 0) & known)
        T = keyframe.T_world_camera
        ends = se3.transform_points(T, back_project(
            self.camera, lines.ends_px[new], lines.depth_m[new]).reshape(-1, 3)).reshape(-1, 2, 3)
        keyframe.line_of[new] = map_.lines.add(ends, lines.descriptor[new],
                                               np.zeros(len(new), np.int32), T[:3, 3],
                                               keyframe.number)

    def _cull_landmarks(self, map_: PointLineMap, now: int) -> None:
        """Landmarks that are seldom found where they should be seen, or seen once only, go."""
        recent = map_.keyframes[-(_YOUNG + 2):]
        self._cull(map_.points, [k.point_of for k in recent], now)
        self._cull(map_.lines, [k.line_of for k in recent], now)
        for keyframe in map_.keyframes:
            map_.forget_dead(keyframe)
        map_.points.reuse_dead()
        map_.lines.reuse_dead()

    def _cull(self, table: Landmarks, recent: list[Array], now: int) -> None:
        """Mark what goes; `recent` are the landmarks' rows in the last keyframes."""
        seldom = table.found < self.config.mapping.min_found_share * table.visible
        sightings = np.zeros(table.count, np.int64)
        for of in recent:
            np.add.at(sightings, of[of >= 0], 1)
        lonely = (now - table.born == _YOUNG) & (sightings < 2)
        table.alive[seldom | lonely] = False

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
        count = np.zeros(map_.points.count, np.int64)
        for keyframe in map_.keyframes:
            if keyframe.alive:
                np.add.at(count, keyframe.point_of[keyframe.point_of >= 0], 1)
        for keyframe in neighbours:
            rows = keyframe.point_of[keyframe.point_of >= 0]
            if keyframe.number == 0 or not len(rows):
                continue
            if np.mean(count[rows] > 3) > self.config.mapping.redundant_share:
                map_.drop_keyframe(keyframe)
                count[rows] -= 1


def line_misfit_px(ends_world: Array, ends_px: Array, T_world_camera: Array,
                   camera: Intrinsics) -> Array:
    """(N,) mean distance of the projected ends (N, 2, 3) from the seen segments' lines."""
    xyz = se3.transform_points(se3.inverse(T_world_camera), ends_world.reshape(-1, 3))
    uv = project(camera, xyz).reshape(-1, 2, 2)
    along = ends_px[:, 1] - ends_px[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    gap = np.abs(np.sum((uv - ends_px[:, :1]) * normal[:, None], axis=2)).mean(axis=1)
    return np.where(np.isfinite(gap), gap, np.inf)
