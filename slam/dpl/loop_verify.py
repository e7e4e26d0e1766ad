"""Is a keyframe really where another one was? Points, lines and depths must say so, both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.dpl.config import LoopConfig
from slam.dpl.features import Features
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.relocalise import match_keyframe, pose_of
from slam.dpl.track import Fit, PoseTracker, Seen
from slam.geometry import se3
from slam.geometry.arrays import Array

_NEIGHBOURS = 8          # keyframes that make the place around one
_COLUMNS, _ROWS = 8, 6   # of the grid that inliers must cover


@dataclass(frozen=True, slots=True)
class Loop:
    """A keyframe found again at an older one."""

    keyframe: Keyframe
    old: Keyframe
    T_old_keyframe: Array    # (4, 4), as the old part of the map sees it
    inliers: int


def verify(map_: PointLineMap, keyframe: Keyframe, old: Keyframe, tracker: PoseTracker
           ) -> Loop | None:
    """The loop between two keyframes, or None where it is not sure.

    P3P in RANSAC on descriptor matches begins; then landmarks around the old keyframe are looked
    for in the new one, and those around the new one in the old one, points and lines, with depth.
    """
    config = tracker.config.loop
    at, rows = match_keyframe(keyframe.features, old, map_, tracker.config)
    start = pose_of(map_.points.xyz[rows, 0], keyframe.features.points.uv_px[at], tracker.camera)
    if start is None:
        return None
    there = _look(map_, old, keyframe.features, start[0], tracker)
    if there is None:
        return None
    T_old_keyframe = se3.inverse(old.T_world_camera) @ there[0].T_world_camera
    T_back = keyframe.T_world_camera @ se3.inverse(T_old_keyframe)
    back = _look(map_, keyframe, old.features, T_back, tracker)
    if back is None or not plausible(map_, keyframe, old, T_old_keyframe, config):
        return None
    return Loop(keyframe, old, T_old_keyframe, there[0].inliers)


def _look(map_: PointLineMap, around: Keyframe, features: Features, T_world_camera: Array,
          tracker: PoseTracker) -> tuple[Fit, Seen] | None:
    """The pose at which features see the landmarks around a keyframe; None if too few fit."""
    config = tracker.config.loop
    features = features.of_any_landmark(tracker.config.orb.scale)
    points, lines = map_.landmarks_of([around, *map_.neighbours(around, _NEIGHBOURS)])
    for radius_px in (2.0 * config.search_px, config.search_px):
        seen = tracker.look_for(map_, points, lines, features, T_world_camera, radius_px)
        fit = tracker.fit(T_world_camera, seen.pairs, features)
        if fit.inliers < config.min_inliers // 2:
            return None
        T_world_camera = fit.T_world_camera
    return (fit, seen) if _sure(fit, seen, features, tracker) else None


def _sure(fit: Fit, seen: Seen, features: Features, tracker: PoseTracker) -> bool:
    config = tracker.config.loop
    uv = np.concatenate([
        features.points.uv_px[seen.pairs.point[fit.point_fits]],
        features.lines.ends_px[seen.pairs.line[fit.line_fits]].reshape(-1, 2)])
    size = np.array([tracker.camera.width, tracker.camera.height])
    return (fit.inliers >= config.min_inliers and fit.share >= config.min_inlier_share
            and covered(uv / size) >= config.min_area)


def covered(at: Array) -> float:
    """Share of the cells of a grid that hold one of these places (N, 2) in [0, 1]²."""
    cell = np.clip((at * [_COLUMNS, _ROWS]).astype(np.int64), 0, [_COLUMNS - 1, _ROWS - 1])
    return len(np.unique(cell @ [1, _COLUMNS])) / (_COLUMNS * _ROWS)


def plausible(map_: PointLineMap, keyframe: Keyframe, old: Keyframe, T_old_keyframe: Array,
              config: LoopConfig) -> bool:
    """Whether drift may explain the gap; any gap may be where tracking was lost between."""
    between = map_.keyframes[old.number:keyframe.number + 1]
    if any(k.part != keyframe.part for k in between):
        return True
    T = np.array([map_.pose(k.number) for k in between])
    gap = se3.inverse(T[0] @ T_old_keyframe) @ T[-1]
    way = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum()
    turn = se3.rotation_angle(se3.inverse(T[:-1])[:, :3, :3] @ T[1:, :3, :3]).sum()
    seen = map_.points.xyz[keyframe.point_of[keyframe.point_of >= 0], 0]
    away_m = np.median(np.linalg.norm(seen - T[-1, :3, 3], axis=1)) if len(seen) else 1.0
    # An error of position looks like one of direction, and the other way about.
    return bool(np.linalg.norm(gap[:3, 3]) <= config.max_drift * (way + turn * away_m)
                and se3.rotation_angle(gap[:3, :3]) <= config.max_drift * (turn + way / away_m))
