"""Frames so far: each hangs on a keyframe, and goes where that goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.track import TrackedFrame
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, FrameEstimate, Points2D, Segments2D, SlamResult, Status

_SHORTEST_S = 1e-3   # between frames, for a velocity
_LONGEST_S = 0.5     # over a longer time nothing keeps its velocity


@dataclass(slots=True)
class _Row:
    stamp_s: float
    status: Status
    keyframe: int            # −1: none, and the pose is of the world
    T_keyframe_camera: Array


class FrameHistory:
    """All frames in order; the world is the first camera's frame."""

    def __init__(self, map_: PointLineMap) -> None:
        self._map = map_
        self._rows: list[_Row] = []
        self._velocity = np.zeros(6)         # per second
        self.T_world_camera: Array = np.eye(4)

    def __len__(self) -> int:
        return len(self._rows)

    def expected_motion(self, stamp_s: float) -> Array:
        """T_a_b (4, 4) since the last frame, at constant velocity."""
        if not self._rows:
            return np.eye(4)
        dt_s = stamp_s - self._rows[-1].stamp_s
        if not _SHORTEST_S <= dt_s <= _LONGEST_S:      # a repeated frame, a jump: standing still
            return np.eye(4)
        return np.asarray(se3.exp(self._velocity * dt_s))

    def add(self, frame: Frame, T_world_camera: Array, keyframe: Keyframe | None,
            status: Status, reason: str, timings: Mapping[str, float],
            tracked: TrackedFrame | None = None) -> FrameEstimate:
        """A frame with a pose of its own."""
        step = se3.inverse(self.T_world_camera) @ T_world_camera
        if self._rows:
            dt_s = frame.stamp_s - self._rows[-1].stamp_s
            good = (_SHORTEST_S <= dt_s <= _LONGEST_S
                    and self._rows[-1].status is not Status.LOST)
            self._velocity = se3.log(step) / dt_s if good else np.zeros(6)
        return self._append(frame, T_world_camera, step, keyframe, status, reason, timings,
                            tracked)

    def add_lost(self, frame: Frame, keyframe: Keyframe | None, reason: str,
                 timings: Mapping[str, float]) -> FrameEstimate:
        """A frame without: the camera goes on as it did for a short while, then stands."""
        step = self.expected_motion(frame.stamp_s)
        self._velocity = 0.7 * self._velocity
        return self._append(frame, self.T_world_camera @ step, step, keyframe, Status.LOST,
                            reason, timings, None)

    def _append(self, frame: Frame, T: Array, step: Array, keyframe: Keyframe | None,
                status: Status, reason: str, timings: Mapping[str, float],
                tracked: TrackedFrame | None) -> FrameEstimate:
        T = se3.orthonormalised(T)
        self.T_world_camera = T
        hangs = (-1, T) if keyframe is None else (
            keyframe.number, se3.inverse(keyframe.T_world_camera) @ T)
        self._rows.append(_Row(frame.stamp_s, status, *hangs))
        points, segments, inliers = _used(tracked, self._map)
        return FrameEstimate(frame.index, frame.stamp_s, T, se3.orthonormalised(step),
                             status=status, reason=reason, timings_ms=timings, points=points,
                             segments=segments, inliers=inliers)

    def moved_to(self, keyframe: Keyframe, T_world_camera: Array) -> None:
        """The last frame became a keyframe, which mapping may have moved."""
        self.T_world_camera = np.array(T_world_camera)
        row = self._rows[-1]
        row.keyframe, row.T_keyframe_camera = keyframe.number, np.eye(4)

    def amend(self, estimate: FrameEstimate, timings: Mapping[str, float]) -> FrameEstimate:
        """The estimate as it stands after mapping."""
        return replace(estimate, T_world_camera=self.T_world_camera, timings_ms=timings)

    def result(self) -> SlamResult:
        """The run, each frame where its keyframe is now."""
        poses = [row.T_keyframe_camera if row.keyframe < 0 else
                 self._map.pose(row.keyframe) @ row.T_keyframe_camera
                 for row in self._rows]
        points, lines = self._map.points, self._map.lines
        return SlamResult(
            np.array([row.stamp_s for row in self._rows]), np.array(poses).reshape(-1, 4, 4), {},
            tuple(row.status for row in self._rows),
            points_world=points.xyz[points.alive, 0], lines_world=lines.xyz[lines.alive])


def _used(tracked: TrackedFrame | None, map_: PointLineMap
          ) -> tuple[Points2D | None, Segments2D | None, dict[str, int]]:
    """The features that stood for landmarks, for pictures and statistics."""
    if tracked is None:
        return None, None, {}
    points, lines = tracked.features.points, tracked.features.lines
    p, q = np.flatnonzero(tracked.point_of >= 0), np.flatnonzero(tracked.line_of >= 0)
    point_id, line_id = (map_.points.identity[tracked.point_of[p]],
                         map_.lines.identity[tracked.line_of[q]])
    return (Points2D(points.uv_px[p], points.depth_m[p], point_id, np.zeros(len(p), np.int32)),
            Segments2D(lines.ends_px[q], lines.depth_m[q], line_id, np.zeros(len(q), np.int32)),
            {"points": len(p), "lines": len(q)})
