"""SDPL-SLAM's tracking (III-A to III-C): this file sequences the stages and computes nothing."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from slam.config import SdplConfig
from slam.dynamics.find_again import find_again
from slam.dynamics.masks import associate, overlaps
from slam.dynamics.objects import ObjectTable
from slam.dynamics.sightings import sightings
from slam.frontend.carry import carry_missed
from slam.frontend.first_step import find_step
from slam.frontend.flow import DisFlow, FlowEstimator, given_flow, predicted_flow
from slam.frontend.observe import Observation, observe
from slam.frontend.picture import better_flow, flow_of_masks
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.features import Detected, FeatureTracker, detect
from slam.systems.history import History
from slam.systems.judgement import Tracked
from slam.systems.motion_stage import MotionStage
from slam.systems.stopwatch import Stopwatch
from slam.types import FlowField, Frame, FrameEstimate, Intrinsics, SlamResult, Status

_UNMATCHED = 2     # frames in a row; one may be blurred


class SdplSlam:
    """Camera and object motions from frame to frame, from points and lines."""

    def __init__(self, intrinsics: Intrinsics, config: SdplConfig | None = None,
                 flow_estimator: FlowEstimator | None = None) -> None:
        self.intrinsics = intrinsics
        self.config = SdplConfig() if config is None else config
        self.flow_estimator = flow_estimator or DisFlow(self.config.flow.preset)
        self.objects = ObjectTable(self.config.dynamic)
        self.features = FeatureTracker(self.config)
        self.motions = MotionStage(intrinsics, self.config)
        self.history = History()
        self.previous: Observation | None = None
        self._unmatched = 0      # frames in a row with features that did not match `previous`

    def process(self, frame: Frame) -> FrameEstimate:
        """Track one frame; never raises for what a frame shows."""
        clock = Stopwatch()
        current = observe(frame)
        clock.lap("observe")
        with ThreadPoolExecutor(max_workers=1) as beside:
            return self._process(current, beside, clock)

    def _process(self, current: Observation, beside: ThreadPoolExecutor,
                 clock: Stopwatch) -> FrameEstimate:
        def look() -> Future[Detected]:
            # What the picture shows is wanted last: a second core looks for it meanwhile.
            detected = beside.submit(detect, current, self.config)
            beside.submit(self.motions.prepare, current)
            return detected

        if self.previous is None:
            return self._begin(current, look(), clock)
        if not current.rho.any():
            return self._lost(current, look(), "no depth in this frame", clock)
        expected = (self.history.expected_motion(
            current.frame.stamp_s - self.previous.frame.stamp_s) if self.history.has_motion
            else self._step_by_features(self.previous, current))
        flow = self._flow(self.previous, current, expected, clock)
        # Not before: dense flow comes out otherwise where it has to share OpenCV's threads.
        detected = look()
        learnt = self.motions.learnt
        tracked, seen, pairs = self._track(self.previous, current, flow, expected, clock)
        if tracked.lost_because and self.history.has_motion:
            # A motion that goes on otherwise than expected leads the search astray.
            self.motions.learnt = learnt
            detected.result()
            expected = self._step_by_features(self.previous, current)
            flow = self._flow(self.previous, current, expected, clock)
            tracked, seen, pairs = self._track(self.previous, current, flow, expected, clock)
        if tracked.lost_because:
            self.motions.learnt = learnt
            return self._lost(current, detected, tracked.lost_because, clock)
        return self._keep(seen, detected, pairs, tracked, clock)

    def finish(self) -> SlamResult:
        """The whole run."""
        return self.history.result(self.features.finished_static_line_lengths())

    def _begin(self, current: Observation, detected: Future[Detected],
               clock: Stopwatch) -> FrameEstimate:
        frame = current.frame
        self._take_as_reference(current, detected.result())
        clock.lap("detect")
        return self.history.add(FrameEstimate(
            frame.index, frame.stamp_s, self.history.T_world_camera, np.eye(4),
            status=Status.FIRST, points=self.features.points, segments=self.features.segments,
            timings_ms=clock.laps_ms()))

    def _take_as_reference(self, current: Observation, detected: Detected) -> None:
        """Track from this frame on, with nothing carried over but the objects' numbers."""
        self._follow_objects(current, {}, -np.inf, self.history.T_world_camera)
        self.features.restart(current, detected)
        self.previous, self._unmatched = current, 0

    def _track(self, previous: Observation, current: Observation, flow: FlowField,
               expected: Array, clock: Stopwatch) -> tuple[Tracked, Observation, dict[int, int]]:
        """All motions, from the camera's expected one and where the objects' last ones lead to.

        Also the current frame with the masks that were missed in it, and the pairs of masks.
        """
        pairs = associate(overlaps(flow, previous.label_index, current.label_index),
                          previous.labels, current.labels, self.config.dynamic.min_overlap)
        current, carried = self._carry(previous, current, flow, pairs, se3.inverse(expected))
        pairs |= carried
        clock.lap("masks")
        return self.motions.track(previous, current, flow, pairs, self.features, expected,
                                  self.objects, self.history.T_world_camera, clock
                                  ), current, pairs

    def _carry(self, previous: Observation, current: Observation, flow: FlowField,
               pairs: dict[int, int], T_b_a: Array) -> tuple[Observation, dict[int, int]]:
        """The current frame with the masks that it misses, and what they continue."""
        before_s, stamp_s = previous.frame.stamp_s, current.frame.stamp_s
        states = self.objects.of_label(before_s)
        moved = {label: T_b_a @ self.objects.predicted_relative(
                     states[label].track, self.history.T_world_camera, stamp_s - before_s)
                 for label in self.objects.missed(pairs, before_s, stamp_s)}
        return carry_missed(previous, current, flow, moved, self.intrinsics,
                            self.config.noise.inverse_depth_sigma, self.config.dynamic.min_overlap)

    def _flow(self, previous: Observation, current: Observation, expected: Array,
              clock: Stopwatch) -> FlowField:
        """The flow given with the frame, or our own, from the camera motion expected."""
        given = given_flow(previous.frame, current.frame)
        if given is not None:
            flow = given
        elif self.config.flow.predict:
            predicted = self._expected_flow(previous, current, expected)
            found = self.flow_estimator(previous.gray, current.gray, predicted)
            flow = replace(found, flow_px=better_flow(
                found.flow_px, predicted, previous.label_index, np.arange(1, len(previous.labels)),
                previous.gray, current.gray))
        else:
            flow = self.flow_estimator(previous.gray, current.gray)
        clock.lap("flow")
        return flow

    def _expected_flow(self, previous: Observation, current: Observation,
                       T_a_b_expected: Array) -> Array:
        """(H, W, 2) float32: what the motions so far lead to, and the pictures of new things."""
        T_b_a = se3.inverse(T_a_b_expected)
        states = self.objects.of_label(previous.frame.stamp_s)
        dt_s = current.frame.stamp_s - previous.frame.stamp_s
        moving = {label: T_b_a @ self.objects.predicted_relative(
                      s.track, self.history.T_world_camera, dt_s)
                  for label, s in states.items() if s.H_world is not None and not s.parked}
        known = {i: moving[int(label)] for i, label in enumerate(previous.labels)
                 if int(label) in moving}
        flow = predicted_flow(previous.frame.depth_m, previous.label_index, T_b_a, known,
                              self.intrinsics)
        unknown = np.array([i for i, label in enumerate(previous.labels)
                            if i > 0 and label not in moving
                            and not (label in states and states[label].parked)], dtype=np.int64)
        return flow_of_masks(flow, previous.label_index, unknown, previous.gray, current.gray)

    def _follow_objects(self, current: Observation, pairs: dict[int, int], before_s: float,
                        T_world_camera: Array) -> dict[int, int]:
        """Tracks of the masks: those that follow from the frame before, and those found again.

        Returns:
            label now -> lost track, of those found again.
        """
        stamp_s = current.frame.stamp_s
        seen = sightings(current.labels, current.label_index, current.rho, current.frame.rgb,
                         T_world_camera, self.intrinsics)
        new = seen.without(pairs)
        lost = self.objects.lost(pairs.values(), before_s)
        again = find_again(lost, new, T_world_camera, stamp_s, self.config.dynamic)
        labels = [int(x) for x in current.labels[1:]]
        self.objects.relabel(pairs, labels, before_s, stamp_s, again, current.carried)
        self.objects.locate(seen, stamp_s)
        return again

    def _step_by_features(self, previous: Observation, current: Observation) -> Array:
        """The camera's step T_a_b (4, 4) where no motion goes on; flow that is given needs none."""
        if given_flow(previous.frame, current.frame) is not None:
            return np.eye(4)
        return find_step(previous, current, self.intrinsics)

    def _lost(self, current: Observation, detected: Future[Detected], reason: str,
              clock: Stopwatch) -> FrameEstimate:
        """Predict the pose, and go on from the last good frame as long as it can be seen."""
        frame = current.frame
        estimate = self.history.add_lost(frame, reason, clock.laps_ms())
        # Once frames that show something do not match, the frame they do not match is at fault;
        # so it is where nothing was ever tracked.
        shows = self.features.found_on(current, detected.result())
        self._unmatched = self._unmatched + 1 if shows else 0
        if (self._unmatched >= _UNMATCHED or not self.history.has_motion
                or self.history.lost_in_a_row >= self.config.start.give_up_after):
            self.history.T_world_camera = estimate.T_world_camera
            self._take_as_reference(current, detected.result())
        return estimate

    def _keep(self, current: Observation, detected: Future[Detected], pairs: dict[int, int],
              tracked: Tracked, clock: Stopwatch) -> FrameEstimate:
        assert self.previous is not None
        frame, before = current.frame, self.previous.frame
        moved = [s.track for s in self.objects.of_label(before.stamp_s).values() if not s.parked]
        again = self._follow_objects(current, pairs, before.stamp_s,
                                     self.history.T_world_camera @ tracked.T_a_b)
        estimate = self.history.add_tracked(frame, before, tracked, self.objects, self.config)
        clock.lap("objects")
        self.features.advance(current, detected.result(), tracked)
        clock.lap("detect")
        self.previous, self._unmatched = current, 0
        new = [f"mask {label}: {'seen again' if label in again else 'first seen'}"
               for label in current.labels[1:] if int(label) not in pairs]
        gone = [f"track {track}: no mask continues it" for track in moved
                if not self.objects.is_seen(track, frame.stamp_s)]
        estimate = replace(estimate, points=self.features.points, segments=self.features.segments,
                           timings_ms=clock.laps_ms(),
                           reason="; ".join([*filter(None, [estimate.reason]), *new, *gone]))
        return self.history.amend(estimate)
