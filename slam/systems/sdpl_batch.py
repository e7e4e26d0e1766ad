"""SDPL-SLAM's tracking, a partial batch with every frame, and a global one when the run ends."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from slam.backend.anchors import PointAnchors
from slam.backend.chained import refine_chained
from slam.backend.config import SdplBatchConfig
from slam.backend.flow_errors import SuccessiveErrors
from slam.backend.frame_bodies import frame_bodies
from slam.backend.line_anchors import LineAnchors
from slam.backend.refine_run import refine_run, run_of_record
from slam.backend.window import SlidingWindow
from slam.estimation.covariance import known_or_none, object_covariance
from slam.frontend.flow import FlowEstimator, given_flow
from slam.frontend.observe import Observation
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import STATIC, MapRecord
from slam.systems.judgement import Tracked
from slam.systems.motion_stage import MotionStage
from slam.systems.sdpl import SdplSlam
from slam.types import Frame, FrameEstimate, Intrinsics, Segments2D, SlamResult, Status

_UNKNOWN = np.full((6, 6), np.nan)   # covariance


class _HeardMotions(MotionStage):
    """Motion stage whose last answer, with its information matrices, can be read."""

    last: Tracked | None = None

    def track(self, *args: Any, **settings: Any) -> Tracked:
        self.last = super().track(*args, **settings)
        return self.last


class SdplBatch:
    """Tracking as `SdplSlam`; each frame's pose is refined with the last ones, and tracking goes on
    from there; `finish` refines all poses and object motions.
    """

    def __init__(self, intrinsics: Intrinsics, config: SdplBatchConfig | None = None,
                 flow_estimator: FlowEstimator | None = None) -> None:
        config = SdplBatchConfig() if config is None else config
        self.backend = config.backend
        self.tracker = SdplSlam(intrinsics, config, flow_estimator)
        self._motions = _HeardMotions(intrinsics, self.tracker.config)
        self.tracker.motions = self._motions
        self.intrinsics = intrinsics
        self.record = MapRecord()
        self._points = PointAnchors(intrinsics, self.backend.anchors, self.tracker.config.noise,
                                    self.record.points)
        self._lines = LineAnchors(intrinsics, self.backend.anchors, self.tracker.config.noise,
                                  self.record.lines)
        self._flow_errors = SuccessiveErrors(intrinsics)
        self._since_detection = 0
        self._sought_on: set[int] = set()             # bodies, when landmarks were detected last
        self._window = SlidingWindow(intrinsics, self.backend.window, self.backend.bundle,
                                     self.record)
        self._last_row, self._last_pose = 0, np.eye(4)     # of the frame recorded last
        self._body_of_track: dict[int, int] = {}      # of the objects that moved last

    def process(self, frame: Frame) -> FrameEstimate:
        """Track one frame, and record what it shows of the landmarks."""
        before = self.tracker.previous
        estimate = self.tracker.process(frame)
        start = perf_counter()
        self.record.indices.append(frame.index)
        row = len(self.record.indices) - 1
        reference = self.tracker.previous
        if reference is None or reference.frame is not frame:
            return estimate                       # lost, and tracking goes on from an earlier frame
        self._measure_flow_errors(before, frame, estimate)
        self._record(row, reference, estimate)
        anchored = perf_counter()
        if self.backend.window.enabled:
            self._window.advance(row, [STATIC, *self._body_of_track.values()])
            estimate = self._corrected(replace(estimate, reason=self._with_not_refined(estimate)))
        if not self.backend.global_batch:
            self.record.points.forget()           # the window has taken them in
            self.record.lines.forget()
        self._last_row, self._last_pose = row, estimate.T_world_camera
        timings = dict(estimate.timings_ms) | {
            "anchors": 1e3 * (anchored - start), "partial batch": 1e3 * (perf_counter() - anchored)}
        return self.tracker.history.amend(replace(estimate, timings_ms=timings))

    def _with_not_refined(self, estimate: FrameEstimate) -> str:
        """The estimate's reason, and what the window left as it was tracked."""
        names = {body: f"track {track}" for track, body in self._body_of_track.items()}
        left = [f"{names.get(body, 'camera')}, as tracked: {why}"
                for body, why in self._window.not_refined.items()]
        return "; ".join([*filter(None, [estimate.reason]), *left])

    def _corrected(self, estimate: FrameEstimate) -> FrameEstimate:
        """The estimate as the window has it; the tracker predicts the next frame from it."""
        bodies = self.record.bodies
        X = bodies[STATIC].poses[-1]
        S = X @ se3.inverse(estimate.T_world_camera)
        self.tracker.history.T_world_camera = X
        if len(bodies[STATIC].poses) < 2 or estimate.status is not Status.TRACKED:
            return replace(estimate, T_world_camera=X)
        X_before = bodies[STATIC].poses[-2]
        of_steps = self._window.step_covariance
        objects = {}
        for track, motion in estimate.objects.items():
            number = self._body_of_track[track]
            Y_before, Y = bodies[number].poses[-2:]
            # H = L_k L_{k−1}⁻¹ with L = X Y⁻¹.
            H = se3.orthonormalised(X @ se3.inverse(Y) @ Y_before @ se3.inverse(X_before))
            self.tracker.objects.correct(track, H)
            objects[track] = replace(motion, H_world=H, centroid_world=se3.transform_points(
                S, motion.centroid_world[None])[0], covariance=known_or_none(
                    object_covariance(X_before, se3.inverse(Y_before) @ Y,
                                      of_steps.get(STATIC, _UNKNOWN),
                                      of_steps.get(number, _UNKNOWN))))
        step = se3.inverse(X_before) @ X
        self.tracker.history.correct(step)
        made = replace(estimate, T_world_camera=X, T_previous_camera=step, objects=objects,
                       covariance=of_steps.get(STATIC))
        if self._last_row == len(self.record.indices) - 2:
            return made
        # Frames between were lost: their poses are predicted, and the last one begins this step.
        lost = self.tracker.history.estimates[-2].T_world_camera
        return replace(made, T_previous_camera=se3.inverse(lost) @ X, covariance=None)

    def finish(self) -> SlamResult:
        """The run after the global batch."""
        tracked = self.tracker.finish()
        if not self.backend.global_batch:
            return run_of_record(self.record, tracked)
        if self.backend.formulation == "paper":
            return refine_chained(self.record, tracked, self.intrinsics, self.backend.bundle,
                                  self.backend.chain)
        return refine_run(self.record, tracked, self.intrinsics, self.backend.bundle)

    def _measure_flow_errors(self, before: Observation | None, frame: Frame,
                             estimate: FrameEstimate) -> None:
        tracked = self._motions.last
        flow = None if before is None else given_flow(before.frame, frame)
        if (before is None or tracked is None or flow is None
                or estimate.status is not Status.TRACKED):
            self._flow_errors.interrupted()
            return
        self._flow_errors.take_in(flow, before, se3.inverse(tracked.T_a_b))
        self.record.step_correlation = self._flow_errors.correlation

    def _record(self, row: int, current: Observation, estimate: FrameEstimate) -> None:
        # Where tracking began here, nothing is known of the step to this frame.
        tracked = self._motions.last if estimate.status is Status.TRACKED else None
        weight = 1.0 if current.frame.flow is None else self.backend.window.given_flow_weight
        information = np.zeros((6, 6)) if tracked is None else tracked.information
        by_label = {} if tracked is None else {o.label: o.information for o in tracked.objects}
        X = estimate.T_world_camera
        step = se3.inverse(self._last_pose) @ X
        static = self.record.bodies[STATIC]
        if static.frames:
            static.add(row, step, information, weight=weight)
        else:
            static.begin(row, X)
        current_bodies: dict[int, int] = {}
        for track, motion in estimate.objects.items():
            body = self._body_of_track.get(track)
            if body is None:
                body = self._begin_body(track, motion.centroid_world)
            # Y_{k−1}⁻¹ Y_k with Y = L⁻¹ X and L_k = H_k L_{k−1}.
            in_body = se3.inverse(self._last_pose) @ se3.inverse(motion.H_world) @ X
            # Of what bends, a motion holds less than its many points claim.
            known = motion.rigidity**2 * by_label[motion.instance_id]
            self.record.bodies[body].add(row, in_body, known, motion.rigidity, weight)
            current_bodies[track] = body
        poses = {body: self.record.bodies[body].poses[-1]
                 for body in (STATIC, *current_bodies.values())}
        self._body_of_track = current_bodies
        body_of_label = {m.instance_id: current_bodies[t] for t, m in estimate.objects.items()}
        body_of_label |= dict.fromkeys(estimate.static_labels, STATIC)
        self._anchor(row, current, poses, body_of_label, estimate.segments)

    def _anchor(self, row: int, current: Observation, poses: dict[int, Array],
                body_of_label: dict[int, int], segments: Segments2D | None) -> None:
        """Find the landmarks again, and new ones where there are too few."""
        now = frame_bodies(row, current, self._motions.smoothed(current), poses, body_of_label,
                           self._window.due(row, poses))
        if now is None:
            return
        self._points.follow(now)
        self._lines.follow(now)
        self._since_detection += 1
        if (self._since_detection >= self.backend.anchors.every
                or not self._sought_on.issuperset(poses)):
            self._points.detect(now)
            if self.backend.anchors.lines and segments is not None:
                self._lines.detect(now, segments)
            self._since_detection, self._sought_on = 0, set(poses)

    def _begin_body(self, track: int, centroid_world: Array) -> int:
        """A body at the object's centroid, with the frame before its first motion."""
        body = self.record.new_body(track)
        L = se3.from_rotation_translation(np.eye(3), centroid_world)
        self.record.bodies[body].begin(self._last_row, se3.inverse(L) @ self._last_pose)
        return body
