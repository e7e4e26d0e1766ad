"""What has been estimated so far: poses, object motions, status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from slam.config import SdplConfig
from slam.dynamics.objects import ObjectTable
from slam.dynamics.scene_flow import moves
from slam.dynamics.smooth_motion import MeasuredMotion, keep_moving
from slam.estimation.covariance import covariance_of, object_covariance
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.motion_stage import ObjectMotion, Tracked
from slam.types import (
    Frame,
    FrameEstimate,
    ObjectEstimate,
    ObjectTrack,
    SlamResult,
    Status,
)

_SHORTEST_S = 1e-3   # between frames
_LONGEST_S = 1.0     # over a longer time nothing keeps its velocity


class History:
    """All estimates in order; the world is the first camera's frame."""

    def __init__(self) -> None:
        self.estimates: list[FrameEstimate] = []
        self.T_world_camera: Array = np.eye(4)     # where tracking goes on from
        self.lost_in_a_row = 0
        self._velocity: Array | None = None        # (6,) per second
        self._last_dt_s = 1.0                      # the time over which it was measured

    @property
    def has_motion(self) -> bool:
        return self._velocity is not None

    def expected_motion(self, dt_s: float) -> Array:
        """T_a_b (4, 4) at constant velocity over a time, a second at most."""
        if self._velocity is None:
            return np.eye(4)
        return np.asarray(se3.exp(self._velocity * min(max(dt_s, 0.0), _LONGEST_S)))

    def correct(self, T_a_b: Array) -> None:
        """Predict from a better estimate of the camera's last motion (4, 4)."""
        if self._velocity is not None:
            self._velocity = se3.log(T_a_b) / self._last_dt_s

    def add(self, estimate: FrameEstimate) -> FrameEstimate:
        self.estimates.append(estimate)
        return estimate

    def amend(self, estimate: FrameEstimate) -> FrameEstimate:
        """Replace the last estimate by one that says more."""
        self.estimates[-1] = estimate
        return estimate

    def add_lost(self, frame: Frame, reason: str, timings: Mapping[str, float]) -> FrameEstimate:
        last = self.estimates[-1]
        step = self.expected_motion(frame.stamp_s - last.stamp_s)
        self.lost_in_a_row += 1
        return self.add(FrameEstimate(frame.index, frame.stamp_s, last.T_world_camera @ step, step,
                                      status=Status.LOST, reason=reason, timings_ms=timings))

    def add_tracked(self, frame: Frame, before: Frame, tracked: Tracked, objects: ObjectTable,
                    config: SdplConfig) -> FrameEstimate:
        """Record a frame's motions; `before` is the frame they start from."""
        dt_s = max(frame.stamp_s - before.stamp_s, 1e-6)
        T_world_a = self.T_world_camera
        T_world_b = se3.orthonormalised(T_world_a @ tracked.T_a_b)
        of_camera = covariance_of(tracked.information / tracked.sharing)
        moving: dict[int, ObjectEstimate] = {}
        still: list[int] = []
        track_of = {s.label: s.track for s in objects.of_label(frame.stamp_s).values()}
        for found in tracked.objects:
            track = track_of[found.label]
            estimate = _object_estimate(found, T_world_a, tracked.T_a_b, of_camera)
            state = objects.states[track]
            is_moving = moves(found.relative, tracked.information, found.information,
                              found.points_a, dt_s, config.dynamic, np.isfinite(state.moved_s))
            velocity = None
            if (config.smooth.enabled and estimate.covariance is not None
                    and frame.stamp_s - before.stamp_s > _SHORTEST_S):
                velocity = keep_moving(
                    state.velocity, MeasuredMotion(estimate.H_world, estimate.covariance,
                                                   before.stamp_s, frame.stamp_s),
                    estimate.centroid_world, config.smooth)
                H_world, covariance = velocity.motion(dt_s)
                estimate = replace(estimate, H_world=H_world, covariance=covariance)
            trusted = found.rigidity >= config.dynamic.trusted_rigidity
            if objects.judged(track, is_moving, frame.stamp_s,
                              estimate.H_world if trusted else None, dt_s, velocity):
                moving[track] = estimate
            else:
                still.append(found.label)
        for label, _ in tracked.left_out:
            objects.forget_motion(track_of[label])
        if frame.stamp_s - before.stamp_s > _SHORTEST_S:       # broken stamps tell no velocity
            self._velocity, self._last_dt_s = se3.log(tracked.T_a_b) / dt_s, dt_s
        # After lost frames the step begins at a pose that was only predicted.
        of_step = of_camera if self.lost_in_a_row == 0 else None
        self.T_world_camera, self.lost_in_a_row = T_world_b, 0
        left_out = "; ".join(f"mask {label}: {why}" for label, why in tracked.left_out)
        last = self.estimates[-1].T_world_camera
        return self.add(FrameEstimate(
            frame.index, frame.stamp_s, T_world_b, se3.inverse(last) @ T_world_b, moving,
            Status.TRACKED, left_out, static_labels=tuple(still), covariance=of_step,
            inliers={"points": tracked.inlier_points, "lines": tracked.inlier_lines}))

    def result(self, static_line_lengths: Array) -> SlamResult:
        """The run as it stands."""
        poses = [e.T_world_camera for e in self.estimates]
        tracks: dict[int, list[tuple[int, ObjectEstimate]]] = {}
        for estimate in self.estimates:
            for track, motion in estimate.objects.items():
                tracks.setdefault(track, []).append((estimate.index, motion))
        return SlamResult(
            np.array([e.stamp_s for e in self.estimates]),
            np.array(poses).reshape(-1, 4, 4),
            {track: ObjectTrack(np.array([k for k, _ in rows]),
                                np.array([m.H_world for _, m in rows]),
                                np.array([m.centroid_world for _, m in rows]))
             for track, rows in tracks.items()},
            tuple(e.status for e in self.estimates),
            static_line_tracklet_lengths=static_line_lengths)


def _object_estimate(found: ObjectMotion, T_world_a: Array, T_a_b: Array,
                     of_camera: Array | None) -> ObjectEstimate:
    H_world = se3.orthonormalised(T_world_a @ found.relative @ se3.inverse(T_world_a))
    points = found.points_a if len(found.points_a) else np.zeros((1, 3))
    centroid = se3.transform_points(T_world_a, points).mean(axis=0)
    covariance = object_covariance(T_world_a, se3.inverse(found.relative) @ T_a_b, of_camera,
                                   covariance_of(found.information / found.sharing))
    return ObjectEstimate(H_world, centroid, found.label, found.rigidity, found.inliers, covariance)
