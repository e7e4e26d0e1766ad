"""SDPL-SLAM's tracking, and the global batch over what it saw when the run ends."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from slam.backend.anchors import AnchorTracker
from slam.backend.config import BackendConfig
from slam.backend.refine_run import refine_run
from slam.config import SdplConfig
from slam.frontend.flow import FlowEstimator
from slam.frontend.observe import Observation
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import STATIC, MapRecord
from slam.systems.motion_stage import MotionStage, Tracked
from slam.systems.sdpl import SdplSlam
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult, Status


class _HeardMotions(MotionStage):
    """Motion stage whose last answer, with its information matrices, can be read."""

    last: Tracked | None = None

    def track(self, *args: Any, **settings: Any) -> Tracked:
        self.last = super().track(*args, **settings)
        return self.last


class SdplBatch:
    """Tracking as `SdplSlam`; `finish` refines all poses and object motions."""

    def __init__(self, intrinsics: Intrinsics, config: SdplConfig | None = None,
                 flow_estimator: FlowEstimator | None = None,
                 backend: BackendConfig | None = None) -> None:
        self.backend = BackendConfig() if backend is None else backend
        self.tracker = SdplSlam(intrinsics, config, flow_estimator)
        self._motions = _HeardMotions(intrinsics, self.tracker.config)
        self.tracker.motions = self._motions
        self.intrinsics = intrinsics
        self.record = MapRecord()
        self._anchors = AnchorTracker(intrinsics, self.backend.anchors,
                                      self.tracker.config.noise)
        self._last_row, self._last_pose = 0, np.eye(4)     # of the frame recorded last
        self._body_of_track: dict[int, int] = {}      # of the objects that moved last

    def process(self, frame: Frame) -> FrameEstimate:
        """Track one frame, and record what it shows of the landmarks."""
        estimate = self.tracker.process(frame)
        start = perf_counter()
        self.record.indices.append(frame.index)
        row = len(self.record.indices) - 1
        reference = self.tracker.previous
        if reference is None or reference.frame is not frame:
            return estimate                       # lost, and tracking goes on from an earlier frame
        self._record(row, reference, estimate)
        timings = dict(estimate.timings_ms) | {"anchors": 1e3 * (perf_counter() - start)}
        return self.tracker.history.amend(replace(estimate, timings_ms=timings))

    def finish(self) -> SlamResult:
        """The run after the global batch."""
        return refine_run(self.record, self.tracker.finish(), self.intrinsics,
                          self.backend.bundle)

    def _record(self, row: int, current: Observation, estimate: FrameEstimate) -> None:
        # Where tracking began here, nothing is known of the step to this frame.
        tracked = self._motions.last if estimate.status is Status.TRACKED else None
        weight = 1.0 if current.frame.flow is None else self.backend.given_flow_weight
        information = np.zeros((6, 6)) if tracked is None else weight * tracked.information
        by_label = {} if tracked is None else {o.label: weight * o.information
                                               for o in tracked.objects}
        X = estimate.T_world_camera
        self.record.bodies[STATIC].add(row, X, information)
        poses: dict[int, Array] = {STATIC: X}
        current_bodies: dict[int, int] = {}
        for track, motion in estimate.objects.items():
            body = self._body_of_track.get(track)
            if body is None:
                body = self._begin_body(track, motion.centroid_world)
            before = self.record.bodies[body]
            # Y_k = L_k⁻¹ X_k with L_k = H_k L_{k−1} and L_{k−1} = X_{k−1} Y_{k−1}⁻¹.
            L = motion.H_world @ self._last_pose @ se3.inverse(before.poses[-1])
            poses[body] = se3.orthonormalised(se3.inverse(L) @ X)
            before.add(row, poses[body], by_label[motion.instance_id])
            current_bodies[track] = body
        self._body_of_track = current_bodies
        body_of_label = {m.instance_id: current_bodies[t] for t, m in estimate.objects.items()}
        body_of_label |= dict.fromkeys(estimate.static_labels, STATIC)
        self._anchors.observe(row, current, poses, body_of_label, self.record)
        self._last_row, self._last_pose = row, X

    def _begin_body(self, track: int, centroid_world: Array) -> int:
        """A body at the object's centroid, with the frame before its first motion."""
        body = self.record.new_body(track)
        L = se3.from_rotation_translation(np.eye(3), centroid_world)
        self.record.bodies[body].add(self._last_row, se3.inverse(L) @ self._last_pose,
                                     np.zeros((6, 6)))
        return body
