"""What has been estimated so far: poses, object motions, status."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from slam.config import SdplConfig
from slam.dynamics.objects import ObjectState, ObjectTable
from slam.dynamics.scene_flow import BodySteps, CameraStep, moving
from slam.dynamics.smooth_motion import BodyVelocity, MeasuredMotions, keep_moving
from slam.estimation.covariance import covariance_of, known_or_none, object_covariance
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.judgement import Tracked
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
        """Record an estimate; its features, the most of it, are for the caller alone."""
        self.estimates.append(_without_features(estimate))
        return estimate

    def amend(self, estimate: FrameEstimate) -> FrameEstimate:
        """Replace the last estimate by one that says more."""
        self.estimates[-1] = _without_features(estimate)
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
        track_of = {s.label: s.track for s in objects.of_label(frame.stamp_s).values()}
        tracks = [track_of[found.label] for found in tracked.objects]
        states = [objects.states[track] for track in tracks]
        estimates = _object_estimates(tracked, T_world_a, of_camera)
        velocities: list[BodyVelocity | None] = [None] * len(tracks)
        if config.smooth.enabled and frame.stamp_s - before.stamp_s > _SHORTEST_S:
            estimates, velocities = _smoothed(estimates, states, before.stamp_s, frame.stamp_s,
                                              config)
        moved = _moving(tracked, states, dt_s, config)
        dynamic: dict[int, ObjectEstimate] = {}
        still: list[int] = []
        for i, track in enumerate(tracks):
            trusted = estimates[i].rigidity >= config.dynamic.trusted_rigidity
            if objects.judged(track, int(moved[i]), frame.stamp_s,
                              estimates[i].H_world if trusted else None, dt_s, velocities[i]):
                dynamic[track] = estimates[i]
            else:
                still.append(tracked.objects[i].label)
        for label, _ in tracked.left_out:
            objects.forget_motion(track_of[label])
        if frame.stamp_s - before.stamp_s > _SHORTEST_S:       # broken stamps tell no velocity
            self._velocity, self._last_dt_s = se3.log(tracked.T_a_b) / dt_s, dt_s
        # After lost frames the step begins at a pose that was only predicted.
        of_step = known_or_none(of_camera) if self.lost_in_a_row == 0 else None
        self.T_world_camera, self.lost_in_a_row = T_world_b, 0
        left_out = "; ".join(f"mask {label}: {why}" for label, why in tracked.left_out)
        last = self.estimates[-1].T_world_camera
        return self.add(FrameEstimate(
            frame.index, frame.stamp_s, T_world_b, se3.inverse(last) @ T_world_b, dynamic,
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


def _without_features(estimate: FrameEstimate) -> FrameEstimate:
    return replace(estimate, points=None, segments=None)


def _object_estimates(tracked: Tracked, T_world_a: Array, of_camera: Array
                      ) -> list[ObjectEstimate]:
    """The objects' motions in the world, with their covariances, as measured."""
    found = tracked.objects
    relative = np.array([f.relative for f in found]).reshape(-1, 4, 4)
    of_body = np.array([f.information / f.sharing for f in found]).reshape(-1, 6, 6)
    H_world = se3.orthonormalised(T_world_a @ relative @ se3.inverse(T_world_a))
    covariance = object_covariance(T_world_a, se3.inverse(relative) @ tracked.T_a_b, of_camera,
                                   covariance_of(of_body))
    centroid_a = np.array([xyz.mean(axis=0) if len(xyz) else np.zeros(3)
                           for xyz in (f.followers.xyz_a for f in found)]).reshape(-1, 3)
    centroid = se3.transform_points(T_world_a, centroid_a)
    return [ObjectEstimate(H_world[i], centroid[i], f.label, f.rigidity, f.inliers,
                           known_or_none(covariance[i])) for i, f in enumerate(found)]


def _smoothed(estimates: list[ObjectEstimate], states: list[ObjectState], before_s: float,
              stamp_s: float, config: SdplConfig
              ) -> tuple[list[ObjectEstimate], list[BodyVelocity | None]]:
    """The motions joined with those before them, and the velocities that they lead to.

    A motion without a covariance stays as it is.
    """
    out = list(estimates)
    velocities: list[BodyVelocity | None] = [None] * len(estimates)
    known = [i for i, e in enumerate(estimates) if e.covariance is not None]
    if not known:
        return out, velocities
    joined = keep_moving([states[i].velocity for i in known], MeasuredMotions(
        np.array([estimates[i].H_world for i in known]),
        np.array([estimates[i].covariance for i in known]),
        np.array([estimates[i].centroid_world for i in known]), before_s, stamp_s), config.smooth)
    H_world, covariance = joined.motion(stamp_s - before_s)
    for place, i in enumerate(known):
        velocities[i] = joined.of(place)
        out[i] = replace(out[i], H_world=H_world[place], covariance=covariance[place])
    return out, velocities


def _moving(tracked: Tracked, states: list[ObjectState], dt_s: float, config: SdplConfig) -> Array:
    """(G,) whether the objects move, as `moving` says it."""
    found = tracked.objects
    bodies = BodySteps(np.array([f.relative for f in found]).reshape(-1, 4, 4),
                       np.array([f.information for f in found]).reshape(-1, 6, 6),
                       [f.followers for f in found],
                       np.array([np.isfinite(s.moved_s) for s in states], dtype=np.bool_))
    return moving(CameraStep(tracked.T_a_b, tracked.information, dt_s, tracked.depth_error), bodies,
                  config.dynamic)
