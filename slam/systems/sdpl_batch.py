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
        self._row = -1
        self._last_good, self._last_pose = -1, np.eye(4)
        self._body_of_track: dict[int, int] = {}      # of the objects that moved last

    def process(self, frame: Frame) -> FrameEstimate:
        """Track one frame, and record what it shows of the landmarks."""
        self._motions.last = None
        estimate = self.tracker.process(frame)
        start = perf_counter()
        self._row += 1
        if estimate.status is Status.LOST and self._motions.last is not None:
            self._body_of_track = {}
            return estimate
        self._record(estimate)
        timings = dict(estimate.timings_ms) | {"anchors": 1e3 * (perf_counter() - start)}
        return self.tracker.history.amend(replace(estimate, timings_ms=timings))

    def finish(self) -> SlamResult:
        """The run after the global batch."""
        return refine_run(self.record, self.tracker.finish(), self.intrinsics,
                          self.backend.bundle)

    def _record(self, estimate: FrameEstimate) -> None:
        assert self.tracker.previous is not None
        tracked = self._motions.last
        X = estimate.T_world_camera
        information = np.zeros((6, 6)) if tracked is None else tracked.information
        self.record.bodies[STATIC].add(self._row, X, information)
        by_label = {} if tracked is None else {o.label: o.information for o in tracked.objects}
        current: dict[int, int] = {}
        poses: dict[int, Array] = {STATIC: X}
        for track, motion in estimate.objects.items():
            body = self._body_of_track.get(track)
            if body is None:
                body = self._begin_body(track, motion.centroid_world)
            before = self.record.bodies[body]
            # Y_k = L_k⁻¹ X_k with L_k = H_k L_{k−1} and L_{k−1} = X_{k−1} Y_{k−1}⁻¹.
            L = motion.H_world @ self._last_pose @ se3.inverse(before.poses[-1])
            poses[body] = se3.orthonormalised(se3.inverse(L) @ X)
            before.add(self._row, poses[body], by_label[motion.instance_id])
            current[track] = body
        self._body_of_track = current
        body_of_label = {m.instance_id: current[t] for t, m in estimate.objects.items()}
        body_of_label |= dict.fromkeys(estimate.static_labels, STATIC)
        self._anchors.observe(self._row, self.tracker.previous, poses, body_of_label, self.record)
        self._last_good, self._last_pose = self._row, X

    def _begin_body(self, track: int, centroid_world: Array) -> int:
        """A body at the object's centroid, with the frame before its first motion."""
        body = self.record.new_body(track)
        L = se3.from_rotation_translation(np.eye(3), centroid_world)
        self.record.bodies[body].add(self._last_good, se3.inverse(L) @ self._last_pose,
                                     np.zeros((6, 6)))
        return body
