"""DPL-SLAM: this file sequences the stages and computes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.dpl.calibrate import DepthCalibration
from slam.dpl.config import DplConfig
from slam.dpl.culling import StillGround
from slam.dpl.features import Features
from slam.dpl.history import FrameHistory
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.loop_close import LoopCloser
from slam.dpl.loop_detect import LoopDetector
from slam.dpl.loop_verify import verify
from slam.dpl.mapping import LocalMapper
from slam.dpl.memory import LandmarkMemory
from slam.dpl.observe import FrameObserver
from slam.dpl.picture import Picture
from slam.dpl.recalibrate import recalibrate
from slam.dpl.recognise import PlaceIndex
from slam.dpl.reference import Reference
from slam.dpl.relocalise import places
from slam.dpl.track import Fit, PoseTracker, Seen, TrackedFrame
from slam.geometry.arrays import Array
from slam.systems.stopwatch import Stopwatch
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult, Status

_MIN_TO_BEGIN = 50       # points with depth (a line counts for ten) with which a map can begin
_GIVE_UP_AFTER = 15      # lost frames with features in a row; then a new part of the map begins
_TRIED = 10              # keyframes in which a lost frame is sought: those most like it


class DplSlam:
    """Points and lines, dynamic ones removed, against a map of keyframes."""

    matches_stereo = True    # frames with a right picture need no depth

    def __init__(self, intrinsics: Intrinsics, config: DplConfig | None = None) -> None:
        self.intrinsics = intrinsics
        self.config = config = DplConfig() if config is None else config
        self.observe = FrameObserver(intrinsics, config)
        self.tracker = PoseTracker(intrinsics, config)
        self.mapper = LocalMapper(intrinsics, config)
        self.memory = LandmarkMemory(intrinsics, config)
        self.calibration = DepthCalibration(intrinsics, config)
        self.places = PlaceIndex()
        self.loop_detector = LoopDetector(self.places, config.loop)
        self.loop_closer = LoopCloser(self.tracker)
        self.map = PointLineMap()
        self.history = FrameHistory(self.map)
        self.picture: Picture | None = None
        self.ground: StillGround | None = None
        self.before: TrackedFrame | None = None
        self.reference: Reference | None = None
        self.lost_with_features = 0

    def process(self, frame: Frame) -> FrameEstimate:
        """Track one frame; never raises for what a frame shows."""
        clock = Stopwatch()
        self.picture = picture = Picture.of(frame, self.config.depth,
                                            self.calibration.applied)
        seen = self.observe(picture, frame, self.history.expected_motion(frame.stamp_s), clock.lap)
        self.ground = seen.ground
        estimate = self._localise(frame, seen.features, clock)
        reason = "; ".join(part for part in (estimate.reason, self.observe.stereo.fault) if part)
        return replace(estimate, judged=seen.judged, reason=reason)

    def _localise(self, frame: Frame, features: Features, clock: Stopwatch) -> FrameEstimate:
        if self.reference is None:
            return self._begin(frame, features, clock)
        if self.before is None:
            return self._recover(frame, features, clock)
        found = self._track(frame, self.before, features)
        clock.lap("track")
        if found is None:
            return self._lose(frame, features, "too few features fit the map", clock)
        return self._keep(frame, *found, clock)

    def finish(self) -> SlamResult:
        """The whole run, each frame where its keyframe is now."""
        result = self.history.result()
        return replace(result, loops=self.loop_closer.closed()) if self.config.loop.enabled \
            else result

    def _begin(self, frame: Frame, features: Features, clock: Stopwatch) -> FrameEstimate:
        """The first keyframe, once there is something to see."""
        enough = _worth(features) >= _MIN_TO_BEGIN
        if enough:
            self._start_map(len(self.history), self.history.T_world_camera, features)
        clock.lap("map")
        if enough and not len(self.history):
            return self.history.add(frame, np.eye(4), self._leant_on(), Status.FIRST, "",
                                    clock.laps_ms())
        reason = "" if enough else "nothing to begin a map with: too few features with depth"
        return self.history.add_lost(frame, self._leant_on(), reason or "a map begins here",
                                     clock.laps_ms())

    def _start_map(self, row: int, T_world_camera: Array, features: Features) -> None:
        self.map.begin_part()
        blank = TrackedFrame(features, np.array(T_world_camera),
                             np.full(len(features.points), -1, np.int64),
                             np.full(len(features.lines), -1, np.int64))
        self._learn_offset(blank)
        self._insert(row, blank)
        self.lost_with_features = 0

    def _insert(self, row: int, tracked: TrackedFrame) -> None:
        """Make a keyframe of a frame; it is the one that later frames lean on."""
        keyframe = self.mapper.insert(self.map, row, tracked)
        assert self.picture is not None
        self.memory.learn(self.map, keyframe, self.picture)
        self.places.add(keyframe.features.points.descriptor)
        self.places.keep_only(np.array([k.alive for k in self.map.keyframes]))
        if self.config.loop.enabled:
            self._close_loop(keyframe)
        self._apply_offset()
        self.reference = Reference(keyframe, row)
        self.before = TrackedFrame(keyframe.features, keyframe.T_world_camera,
                                   keyframe.point_of.copy(), keyframe.line_of.copy())

    def _learn_offset(self, tracked: TrackedFrame) -> None:
        assert self.picture is not None
        self.calibration.learn(self.picture, tracked)

    def _apply_offset(self) -> None:
        """Once the depths are known to have an offset, the map is corrected for it."""
        more = self.calibration.due()
        if more != 0.0:
            recalibrate(self.map, self.memory, more, self.intrinsics, self.config)
            self.calibration.apply(more)

    def _leant_on(self) -> Keyframe | None:
        return None if self.reference is None else self.reference.keyframe

    def _lean_on_reference(self) -> None:
        """The newest frame has become the reference keyframe, and goes where it goes."""
        assert self.reference is not None
        keyframe = self.reference.keyframe
        self.history.moved_to(keyframe, keyframe.T_world_camera)

    def _come_back(self, tracked: TrackedFrame) -> None:
        """Lean on the keyframe that sees most of what is seen where the camera was found again."""
        shared = self.map.covisible(tracked.point_of[tracked.point_of >= 0],
                                    tracked.line_of[tracked.line_of >= 0])
        self.reference = Reference(self.map.keyframes[int(np.argmax(shared))], len(self.history))

    def _close_loop(self, keyframe: Keyframe) -> None:
        """Where the keyframe shows a place from before, the map is corrected for it."""
        for old in self.loop_detector.candidates(self.map, keyframe):
            loop = verify(self.map, keyframe, old, self.tracker)
            if loop is not None and self.loop_closer.close(self.map, loop):
                self.loop_detector.rest()
                return

    def _track(self, frame: Frame, before: TrackedFrame, features: Features
               ) -> tuple[TrackedFrame, Seen] | None:
        c = self.config.track
        expected = before.T_world_camera @ self.history.expected_motion(frame.stamp_s)
        fit = pairs = None
        point_rows = line_rows = np.zeros(0, np.int64)
        for T_start, radius in ((expected, c.search_px), (expected, c.wide_search_px),
                                (before.T_world_camera, c.wide_search_px)):
            pairs, point_rows, line_rows = self.tracker.against_frame(
                before, features, T_start, self.map, radius)
            fit = self.tracker.fit_beside(self._boxes(), T_start, pairs, features)
            if fit.inliers >= 2 * c.min_inliers and fit.share >= c.min_inlier_share:
                break
        assert fit is not None
        if fit.inliers < c.min_inliers or fit.share < c.min_inlier_share:
            return None
        return self._against_map(features, fit.T_world_camera, point_rows[fit.point_fits],
                                 line_rows[fit.line_fits])

    def _boxes(self) -> Array:
        """(B, 4) of things in this frame that may move."""
        return np.zeros((0, 4)) if self.ground is None else self.ground.boxes

    def _against_map(self, features: Features, T_world_camera: Array, point_rows: Array,
                     line_rows: Array) -> tuple[TrackedFrame, Seen] | None:
        """The pose that the local map supports, and what of the map was looked for.

        The map stays as it is.

        Args:
            point_rows, line_rows: landmarks surely in view.
        """
        c = self.config.track
        shared = self.map.covisible(point_rows[point_rows >= 0], line_rows[line_rows >= 0])
        best = np.argsort(-shared, kind="stable")[:c.local_keyframes]
        local = [self.map.keyframes[i] for i in best if shared[i] > 0]
        points, lines = self.map.landmarks_of(local or [self.map.newest()])
        seen = self.tracker.look_for(self.map, points, lines, features, T_world_camera,
                                     c.local_search_px)
        fit = self.tracker.fit_beside(self._boxes(), T_world_camera, seen.pairs, features)
        if fit.inliers < c.min_inliers:
            return None
        T = fit.T_world_camera
        if self.config.anchors.enabled:
            assert self.picture is not None
            features, seen = self.memory.sharpen(self.map, features, seen, fit.point_fits, T,
                                                 self.picture, self.ground)
        covariance = self.memory.covariance(seen, T)
        fit = self.tracker.fit(T, seen.pairs, features, covariance)
        if self.config.anchors.enabled:
            features = self.memory.weigh(features, seen.pairs, fit.point_fits, fit.T_world_camera)
            fit = self.tracker.fit(fit.T_world_camera, seen.pairs, features, covariance)
        return _associated(features, seen, fit), seen

    def _keep(self, frame: Frame, tracked: TrackedFrame, seen: Seen, clock: Stopwatch
              ) -> FrameEstimate:
        """A pose that is believed: the map counts what it saw, and may grow by the frame."""
        assert self.reference is not None
        row = len(self.history)
        estimate = self.history.add(frame, tracked.T_world_camera, self.reference.keyframe,
                                    Status.TRACKED, "", {}, tracked=tracked)
        self.map.points.count_use(seen.points_in_view, tracked.point_of[tracked.point_of >= 0])
        self.map.lines.count_use(seen.lines_in_view, tracked.line_of[tracked.line_of >= 0])
        self.before, self.lost_with_features = tracked, 0
        self._learn_offset(tracked)
        if self.reference.outgrown(tracked, row, self.config.mapping):
            self._insert(row, tracked)
            self._lean_on_reference()
        clock.lap("map")
        return self.history.amend(estimate, clock.laps_ms())

    def _lose(self, frame: Frame, features: Features, reason: str, clock: Stopwatch
              ) -> FrameEstimate:
        self.before = None
        self.calibration.forget_frame()
        return self._recover(frame, features, clock, reason)

    def _recover(self, frame: Frame, features: Features, clock: Stopwatch, reason: str = ""
                 ) -> FrameEstimate:
        """Find the way back into the map; where that fails for long, begin another part of it."""
        found = self._relocalise(features)
        clock.lap("relocalise")
        if found is not None:
            self._come_back(found[0])
            return self._keep(frame, *found, clock)
        seen = _worth(features) >= _MIN_TO_BEGIN
        self.lost_with_features = self.lost_with_features + 1 if seen else 0
        estimate = self.history.add_lost(frame, self._leant_on(),
                                         reason or "not found in the map yet", clock.laps_ms())
        if self.lost_with_features >= _GIVE_UP_AFTER:
            self._start_map(len(self.history) - 1, estimate.T_world_camera, features)
            self._lean_on_reference()
        return estimate

    def _relocalise(self, features: Features) -> tuple[TrackedFrame, Seen] | None:
        likely = [self.map.keyframes[i] for i in self.places.most_like(
            features.points.descriptor, _TRIED) if self.map.keyframes[i].alive]
        for T_world_camera, points in places(self.map, features, likely, self.intrinsics,
                                             self.config):
            found = self._against_map(features, T_world_camera, points, np.zeros(0, np.int64))
            if found is not None and found[0].held >= self.config.track.relocalise_inliers:
                return found
        return None


def _associated(features: Features, seen: Seen, fit: Fit) -> TrackedFrame:
    """A frame whose features are the landmarks that fit its pose."""
    point_of = np.full(len(features.points), -1, np.int64)
    line_of = np.full(len(features.lines), -1, np.int64)
    point_of[seen.pairs.point[fit.point_fits]] = seen.points[fit.point_fits]
    line_of[seen.pairs.line[fit.line_fits]] = seen.lines[fit.line_fits]
    return TrackedFrame(features, fit.T_world_camera, point_of, line_of)


def _worth(features: Features) -> int:
    """Features with depth, a line for ten points."""
    return int(np.count_nonzero(features.points.depth_m > 0)
               + 10 * np.count_nonzero((features.lines.depth_m > 0).all(axis=1)))
