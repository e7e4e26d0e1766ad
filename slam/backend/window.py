"""The partial batch: the last frames of every body refined together, as each new frame comes.

The window's first pose stays. What a frame that leaves the window has told of the landmarks is
kept as a prior on each of them, taken with the frame's pose as it stands then.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from slam.backend.bundle import BodyPath, LandmarkPrior, Problem, State
from slam.backend.config import BundleConfig, WindowConfig
from slam.backend.descend import levenberg_marquardt
from slam.backend.families import LINE_FAMILIES, Family, PointFamily, Room
from slam.backend.pose_covariance import step_covariances
from slam.backend.refine_run import filled_in
from slam.geometry.arrays import Array
from slam.map import (
    STATIC,
    BodyRecord,
    Features,
    Landmarks,
    MapRecord,
    Observations,
    PointLandmarks,
)
from slam.tables import joined, taken
from slam.types import Intrinsics


@dataclass(slots=True)
class _Alive:
    """Landmarks with sightings in the window."""

    number: Array        # (P,) ascending
    body: Array          # (P,)
    place: Array         # (P, 3) m or (P, 10), as known best
    information: Array   # (P, D, D) of what has left the window
    held: Array          # (P, 3) or (P, 10), where that would have them


class _Seen(Generic[Landmarks, Observations]):
    """Landmarks of one kind in the window, body by body."""

    def __init__(self, features: Features[Landmarks, Observations], family: type[Family],
                 config: WindowConfig) -> None:
        self.features, self.size, self.config = features, family.size, config
        self.room = Room(family)
        self.raw = self.sightings = features.no_observations     # as they came; completed
        self._last = -1                                          # number of the newest landmark
        self.alive = self._fresh(features.no_landmarks)
        self._scales: dict[int, tuple[float, float]] = {}    # body -> measured noise, squared

    def _fresh(self, new: Landmarks) -> _Alive:
        place = new.xyz_body if isinstance(new, PointLandmarks) else new.line_body
        return _Alive(np.array(new.number), np.array(new.body), np.array(place),
                      np.zeros((len(new), self.size, self.size)), np.array(place))

    def take_in(self, row: int, min_sightings: int) -> None:
        """The newest frame's landmarks and sightings; all in the order of bodies and landmarks."""
        fresh = self.features.landmarks_after(self._last)
        for new in fresh:
            self.alive = joined(self.alive, self._fresh(new))
            self._last = int(new.number.max(initial=self._last))
        if fresh:
            self.alive = taken(self.alive, np.lexsort((self.alive.number, self.alive.body)))
        alive = self.alive
        seen = joined(self.raw, *self.features.observations_of(row))
        # A landmark that was away for longer than a window has been forgotten.
        self.raw = taken(seen, np.flatnonzero(np.isin(seen.landmark, alive.number)))
        by_number = np.argsort(alive.number)
        place = by_number[np.searchsorted(alive.number, self.raw.landmark, sorter=by_number)]
        s = filled_in(replace(self.raw, landmark=place))
        count = np.bincount(s.landmark, minlength=len(alive.number))
        useful = (count >= min_sightings) | (alive.information[:, 0, 0] > 0)
        self.sightings = taken(s, np.flatnonzero(useful[s.landmark]))

    def of_body(self, number: int, rows: Array) -> tuple[Observations, slice]:
        """A body's sightings in the window, by row of the window and of its landmarks."""
        s, body = self.sightings, self.alive.body
        first, last = np.searchsorted(body, [number, number + 1])
        begin, end = np.searchsorted(s.landmark, [first, last])
        own = taken(s, slice(begin, end))
        return replace(own, landmark=own.landmark - first,
                       frame=np.searchsorted(rows, own.frame)), slice(first, last)

    def begin(self, number: int, family: Family) -> bool:
        """Start with the noise measured so far; False: there is none."""
        family.uv_scale2, family.rho_scale2 = self._scales.get(number, (1.0, 1.0))
        return number in self._scales

    def keep(self, number: int, family: Family, own: slice, leaving: Array) -> None:
        """Take a body's refined landmarks and noise over, and hold on to what leaves.

        Args:
            leaving: (F,) bool: the frames of the window that do.
        """
        self.alive.place[own] = family.now.place
        if leaving.any():
            # Before the noise is measured anew: with the weights that were used.
            information, held = family.condensed(leaving[family.pose])
            self.alive.information[own] = self.config.prior_weight * information
            self.alive.held[own] = held
        family.measure_noise()
        measured = np.array([family.uv_scale2, family.rho_scale2])
        before = np.array(self._scales.get(number, measured))
        keep = self.config.noise_memory
        uv, rho = np.exp(keep * np.log(before) + (1.0 - keep) * np.log(measured))
        self._scales[number] = float(uv), float(rho)

    def let_go(self, first_row: int, bodies: list[int]) -> None:
        """Forget frames before the next window's, and landmarks that no frame sees any longer."""
        self.raw = taken(self.raw, np.flatnonzero(self.raw.frame >= first_row))
        seen = np.isin(self.alive.number, self.raw.landmark)
        self.alive = taken(self.alive, np.flatnonzero(seen))
        self._scales = {body: self._scales[body] for body in bodies if body in self._scales}


class SlidingWindow:
    """Refines the record's newest poses in place."""

    def __init__(self, camera: Intrinsics, config: WindowConfig, bundle: BundleConfig,
                 record: MapRecord) -> None:
        self.camera, self.config, self.record = camera, config, record
        self.bundle = replace(bundle, iterations=config.iterations)
        self.points = _Seen(record.points, PointFamily, config)
        self.lines = _Seen(record.lines, LINE_FAMILIES[bundle.line_form], config)
        self.step_covariance: dict[int, Array] = {}     # body -> (6, 6) of its newest step
        self.not_refined: dict[int, str] = {}           # body whose turn it was -> why

    def due(self, row: int, bodies: Iterable[int]) -> list[int]:
        """The bodies whose turn it is in a frame: the static world always, objects by turns."""
        return [body for body in bodies
                if body == STATIC or (row + body) % self.config.object_every == 0]

    def advance(self, row: int, bodies: list[int]) -> None:
        """Take in a frame that is in the record already, and refine bodies seen in it."""
        self.step_covariance, self.not_refined = {}, {}
        self.points.take_in(row, self.bundle.min_sightings)
        self.lines.take_in(row, self.bundle.min_sightings)
        first_row = row - self.config.frames + 1
        for number in self.due(row, bodies):
            body = self.record.bodies[number]
            window = slice(bisect_left(body.frames, first_row), None)
            every = 1 if number == STATIC else self.config.object_every
            if len(body.frames[window]) > 1:
                why = self._refine(body, number, window, first_row + every)
                if why:
                    self.not_refined[number] = why
        self.points.let_go(first_row + 1, bodies)
        self.lines.let_go(first_row + 1, bodies)

    def _refine(self, body: BodyRecord, number: int, window: slice, next_first_row: int) -> str:
        """Refine one body in place; why it stays as tracked, or nothing."""
        rows = np.array(body.frames[window])
        s, points = self.points.of_body(number, rows)
        line_s, lines = self.lines.of_body(number, rows)
        if len(s) + len(line_s) == 0:
            return "no landmark has been seen twice"
        path = BodyPath(np.array(body.poses[window]), np.array(body.steps[window]),
                        _weighted(body, window), self.record.step_correlation)
        problem = Problem(path, s, _prior(self.points.alive, points), self.camera, self.bundle,
                          line_s, _prior(self.lines.alive, lines),
                          (self.points.room, self.lines.room))
        begin = State(path.T_body_camera, self.points.alive.place[points],
                      self.lines.alive.place[lines])
        known = [seen.begin(number, family) for seen, family in self._sides(problem)]
        cost = problem.linearise(begin)
        if any(known):
            cost -= problem.drop_misfits()
        state = levenberg_marquardt(problem, begin, self.bundle, cost)
        if not all(np.isfinite(part).all() for part in state):
            return "the system has no finite solution"
        body.poses[window] = list(state.T_body_camera)
        if self.bundle.covariances:
            S, _ = problem.reduced(0.0)
            newest = step_covariances(S, state.T_body_camera)[-1]
            if np.isfinite(newest).all():
                self.step_covariance[number] = newest
        for (seen, family), own in zip(self._sides(problem), (points, lines), strict=True):
            seen.keep(number, family, own, rows < next_first_row)
        return ""

    def _sides(self, problem: Problem) -> tuple[tuple[_Seen, Family], tuple[_Seen, Family]]:
        return (self.points, problem.points), (self.lines, problem.lines)


def _weighted(body: BodyRecord, window: slice) -> Array:
    """(F, 6, 6) information of steps against sightings that count in full."""
    return np.array(body.information[window]) * np.array(body.weight[window])[:, None, None]


def _prior(alive: _Alive, own: slice) -> LandmarkPrior:
    return LandmarkPrior(alive.information[own], alive.held[own])
