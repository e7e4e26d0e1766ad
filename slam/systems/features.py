"""The corners and segments alive, from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.config import SdplConfig
from slam.estimation.tracks import TrackNumbers, empty_points, empty_segments
from slam.frontend.follow import match_segments
from slam.frontend.observe import Observation
from slam.frontend.points import PointConfig, corner_response, detect_points
from slam.frontend.sampling import depth_at, nearest
from slam.frontend.segments import cull_segments, detect_segments
from slam.geometry.arrays import Array
from slam.systems.judgement import Tracked
from slam.tables import joined, taken
from slam.types import Points2D, Segments2D


@dataclass(frozen=True, slots=True)
class Detected:
    """What a frame's picture shows by itself, whatever is carried to it."""

    corners: Array            # (H, W) float32 corner response
    segments: Array           # (N, 2, 2) px


def detect(current: Observation, config: SdplConfig) -> Detected:
    """The part of detection that needs nothing but the frame."""
    corners = corner_response(current.gray)
    if not config.segments.enabled:
        return Detected(corners, np.zeros((0, 2, 2)))
    return Detected(corners, detect_segments(current.gray, config.segments.detector,
                                              config.segments.min_length_px))


class FeatureTracker:
    """Feature tracks: those that survive a frame go on, new ones fill the gaps."""

    def __init__(self, config: SdplConfig) -> None:
        self.config = config
        self.points: Points2D = empty_points()
        self.segments: Segments2D = empty_segments()
        self._age = np.zeros(0, np.int64)
        self._unseen = np.zeros(0, np.int64)
        self._numbers = TrackNumbers()
        self._finished_static: list[Array] = []

    def restart(self, current: Observation, detected: Detected) -> None:
        """Forget all tracks and begin with what this frame shows."""
        self._retire(np.ones(len(self.segments), bool))
        self.points, self.segments = empty_points(), empty_segments()
        self._age = self._unseen = np.zeros(0, np.int64)
        self._complete(current, detected)

    def advance(self, current: Observation, detected: Detected, tracked: Tracked) -> None:
        """Move the tracks to the current frame and begin new ones beside them."""
        depth, labels = current.frame.depth_m, _label_image(current)
        uv = tracked.point_uv
        self.points = Points2D(uv, depth_at(depth, uv), self.points.track_id[tracked.point_index],
                               nearest(labels, uv).astype(np.int32))
        alive = np.zeros(len(self.segments), bool)
        alive[tracked.line_index] = True
        self._retire(~alive)
        self._age, self._unseen = self._age[tracked.line_index], self._unseen[tracked.line_index]
        self.segments = Segments2D(tracked.line_endpoints, np.zeros((len(tracked.line_index), 2)),
                                   self.segments.track_id[tracked.line_index],
                                   np.zeros(len(tracked.line_index), np.int32))
        self._complete(current, detected)

    def found_on(self, current: Observation, detected: Detected) -> bool:
        """Whether a frame has corners with depth on it, enough to track from."""
        wanted = self.config.start.min_points
        uv, _ = detect_points(detected.corners, 10 * wanted, current.instance_id)
        return int(np.count_nonzero(depth_at(current.frame.depth_m, uv))) >= wanted

    def finished_static_line_lengths(self) -> Array:
        """Frames that each static segment track lived, those still alive included."""
        alive = self._age[self.segments.instance_id == 0]
        return np.concatenate([*self._finished_static, alive])

    def _retire(self, gone: Array) -> None:
        self._finished_static.append(self._age[gone & (self.segments.instance_id == 0)])

    def _complete(self, current: Observation, detected: Detected) -> None:
        self._complete_points(current, detected.corners)
        if self.config.segments.enabled:
            self._complete_segments(current, detected.segments)

    def _complete_points(self, current: Observation, corners: Array) -> None:
        """Fill the empty cells of the static world, and the gaps on objects."""
        labels = _label_image(current)
        # Spread, not strongest first: what is strong may lie all in one far tree.
        cell_px = max(8, round(np.sqrt(current.gray.size / self.config.points.static_count)))
        self.points = _one_per_cell(self.points, cell_px)
        settings = PointConfig(static_cell_px=cell_px, object_count=self.config.points.object_count)
        uv, _ = detect_points(corners, corners.size, current.instance_id,
                              self.points.uv_px, settings)
        depth = depth_at(current.frame.depth_m, uv)
        uv, depth = uv[depth > 0], depth[depth > 0]
        ids, self._numbers = self._numbers.take(len(uv))
        new = Points2D(uv, depth, ids, nearest(labels, uv).astype(np.int32))
        self.points = _one_per_cell(joined(self.points, new), cell_px)

    def _complete_segments(self, current: Observation, found: Array) -> None:
        """Segments found now confirm, correct and complete those that were carried."""
        settings = self.config.segments
        confirmed = match_segments(self.segments.endpoints_px, found)
        endpoints = np.where((confirmed >= 0)[:, None, None], found[confirmed] if len(found)
                             else self.segments.endpoints_px, self.segments.endpoints_px)
        fresh = found[np.setdiff1d(np.arange(len(found)), confirmed)]
        ids, self._numbers = self._numbers.take(len(fresh))
        every = joined(
            Segments2D(endpoints, np.zeros((len(endpoints), 2)), self.segments.track_id,
                       self.segments.instance_id),
            Segments2D(fresh, np.zeros((len(fresh), 2)), ids, np.zeros(len(fresh), np.int32)))
        age = np.concatenate([self._age + 1, np.ones(len(fresh), np.int64)])
        unseen = np.concatenate([np.where(confirmed >= 0, 0, self._unseen + 1),
                                 np.zeros(len(fresh), np.int64)])
        kept, label, depth = cull_segments(every.endpoints_px, current.frame.depth_m,
                                           _label_image(current))
        kept &= unseen <= settings.unseen_frames
        kept &= _among_longest(every.endpoints_px, kept, age, settings.max_count)
        gone = ~kept[: len(endpoints)]
        self._retire(gone)
        self._age, self._unseen = age[kept], unseen[kept]
        self.segments = Segments2D(every.endpoints_px[kept], depth[kept], every.track_id[kept],
                                   label[kept].astype(np.int32))


def _label_image(current: Observation) -> Array:
    labels = current.instance_id
    return np.zeros(current.gray.shape, np.int32) if labels is None else labels


def _one_per_cell(points: Points2D, cell_px: int) -> Points2D:
    """The points on objects, and of the static ones the oldest of each cell."""
    cell = np.floor(points.uv_px / cell_px).astype(np.int64)
    place = cell[:, 1] * 100_000 + cell[:, 0]
    place = np.where(points.instance_id == 0, place, -1 - np.arange(len(points)))
    order = np.lexsort((points.track_id, place))
    first = np.ones(len(points), bool)
    first[1:] = np.diff(place[order]) != 0
    return taken(points, np.sort(order[first]))


def _among_longest(endpoints_px: Array, kept: Array, age: Array, count: int) -> Array:
    """The `count` best of the kept: those that live already first, then the longest."""
    length = np.linalg.norm(endpoints_px[:, 1] - endpoints_px[:, 0], axis=1)
    rank = np.argsort(-(np.where(kept, length, -np.inf) + 1e4 * (kept & (age > 1))), kind="stable")
    best = np.zeros(len(endpoints_px), bool)
    best[rank[:count]] = True
    return best
