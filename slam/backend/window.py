"""The partial batch: the last frames of every body refined together, as each new frame comes.

The window's first pose stays. What a frame that leaves the window has told of the landmarks is
kept as a prior on each of them, taken with the frame's pose as it stands then.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from slam.backend.bundle import BodyPath, LandmarkPrior, Problem, levenberg_marquardt
from slam.backend.config import BundleConfig, WindowConfig
from slam.backend.refine_run import filled_in, taken
from slam.geometry.arrays import Array
from slam.map import BodyRecord, MapRecord, PointObservations, no_observations
from slam.types import Intrinsics


@dataclass(slots=True)
class _Landmarks:
    """Those with sightings in the window."""

    number: Array        # (P,) ascending
    body: Array          # (P,)
    xyz: Array           # (P, 3) m, as known best
    information: Array   # (P, 3, 3) of what has left the window
    xyz_held: Array      # (P, 3) m, where that would have them

    def take(self, index: Array) -> _Landmarks:
        return _Landmarks(*(getattr(self, f.name)[index] for f in fields(self)))


class SlidingWindow:
    """Refines the record's newest poses in place."""

    def __init__(self, camera: Intrinsics, config: WindowConfig, bundle: BundleConfig) -> None:
        self.camera, self.config = camera, config
        self.bundle = replace(bundle, iterations=config.iterations)
        self._sightings = no_observations()
        none = np.zeros(0, np.int64)
        self._landmarks = _Landmarks(none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)),
                                     np.zeros((0, 3)))
        self._scales: dict[int, tuple[float, float]] = {}    # body -> measured noise, squared

    def advance(self, row: int, record: MapRecord, bodies: list[int]) -> None:
        """Take in a frame that is in the record already, and refine the bodies seen in it."""
        self._take_in(row, record)
        for body in bodies:
            if len(record.bodies[body].frames) > 1:
                self._refine(record.bodies[body], body)
        s = taken(self._sightings, np.flatnonzero(self._sightings.frame > row - self.config.frames))
        self._sightings = s
        seen = np.isin(self._landmarks.number, s.landmark)
        self._landmarks = self._landmarks.take(np.flatnonzero(seen))
        self._scales = {body: self._scales[body] for body in bodies if body in self._scales}

    def _take_in(self, row: int, record: MapRecord) -> None:
        parts = [self._sightings, *record.observations_of(row)]
        self._sightings = PointObservations(*(np.concatenate([getattr(p, name) for p in parts])
                                              for name in PointObservations.__slots__))
        last = int(self._landmarks.number.max(initial=-1))
        for new in record.landmarks_after(last):
            n, old = len(new), self._landmarks
            fresh = _Landmarks(new.number, new.body, new.xyz_body, np.zeros((n, 3, 3)),
                               np.array(new.xyz_body))
            self._landmarks = _Landmarks(*(np.concatenate([getattr(old, f.name),
                                                           getattr(fresh, f.name)])
                                           for f in fields(old)))

    def _refine(self, body: BodyRecord, number: int) -> None:
        window = slice(-self.config.frames, None)
        rows = np.array(body.frames[window])
        sightings, own = self._of_body(number, rows)
        if len(own) == 0:
            return
        marks = self._landmarks.take(own)
        path = BodyPath(np.array(body.poses[window]), np.array(body.steps[window]),
                        np.array(body.information[window]))
        problem = Problem(path, sightings, LandmarkPrior(marks.information, marks.xyz_held),
                          self.camera, self.bundle)
        problem.uv_scale2, problem.rho_scale2 = self._scales.get(number, (1.0, 1.0))
        if number in self._scales:
            problem.drop_misfits(path.T_body_camera, marks.xyz)
        T, xyz = levenberg_marquardt(problem, path.T_body_camera, marks.xyz, self.bundle)
        if not (np.isfinite(T).all() and np.isfinite(xyz).all()):
            return
        problem.measure_noise(T, xyz)
        self._remember_noise(number, problem)
        body.poses[window] = list(T)
        self._landmarks.xyz[own] = xyz
        if len(rows) == self.config.frames:
            information, held = problem.condensed(T, xyz, sightings.frame == 0)
            self._landmarks.information[own] = self.config.prior_weight * information
            self._landmarks.xyz_held[own] = held

    def _of_body(self, number: int, rows: Array) -> tuple[PointObservations, Array]:
        """A body's sightings in the window, by row of the window and of the landmarks returned."""
        s, marks = self._sightings, self._landmarks
        place = np.searchsorted(marks.number, s.landmark)
        row = np.searchsorted(rows, s.frame)
        known = rows[np.minimum(row, len(rows) - 1)] == s.frame
        index = np.flatnonzero((marks.body[place] == number) & known)
        s = filled_in(replace(taken(s, index), landmark=place[index], frame=row[index]))
        count = np.bincount(s.landmark, minlength=len(marks.number))
        held = marks.information[:, 0, 0] > 0
        useful = (count >= self.bundle.min_sightings) | ((count > 0) & held)
        s = taken(s, np.flatnonzero(useful[s.landmark]))
        own, landmark = np.unique(s.landmark, return_inverse=True)
        return replace(s, landmark=landmark), own

    def _remember_noise(self, number: int, problem: Problem) -> None:
        measured = np.array([problem.uv_scale2, problem.rho_scale2])
        before = np.array(self._scales.get(number, measured))
        keep = self.config.noise_memory
        uv, rho = np.exp(keep * np.log(before) + (1.0 - keep) * np.log(measured))
        self._scales[number] = float(uv), float(rho)
