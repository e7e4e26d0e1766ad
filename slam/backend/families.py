"""Points and lines that a body's poses have seen: two kinds of landmarks, one interface.

A family holds its sightings, their noise, and what is held of its landmarks beside them. It is
evaluated at poses and landmarks, and adds itself to the poses' normal equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.backend.config import BundleConfig
from slam.backend.linearise import (
    UNSEEN_CHI2,
    linearise,
    linearise_line_distances,
    linearise_lines,
    whitening,
)
from slam.backend.pose_system import quadratic
from slam.backend.reduced import landmark_steps, reduce_landmarks
from slam.backend.settle import condense, drop_misfits, likeness, noise_ratios
from slam.geometry.arrays import Array
from slam.line_sightings import change_of_lines, ends_in_metres, moved_lines
from slam.map import LineObservations, PointObservations
from slam.residuals import camera_tuple
from slam.types import Intrinsics

_SMALLEST_SCALE2 = 1e-6       # noise-free input must not make the system singular


@dataclass(frozen=True, slots=True)
class LandmarkPrior:
    """What is held of landmarks beside the sightings given."""

    information: Array       # (P, D, D), D = 3: 1/m²; D = 4: of a line's four parameters
    place: Array             # (P, 3) m or (P, 10), where it would have them


class Linearisation:
    """A family at one point: weighted whitened residuals and derivatives."""

    def __init__(self, r: Array, J: Array, V: Array) -> None:
        self.r, self.J, self.V = r, J, V    # (M, R), (M, R, 6), (M, R, D)
        self.chi2 = np.zeros(0)             # (M,) squared whitened length; inf where unseen
        self.place = np.zeros(0)            # of the landmarks
        self.pull = np.zeros(0)             # (P, D) of the prior


class Room:
    """Memory for two linearisations, taken again by one problem after another.

    Fresh memory costs more than what is written into it.
    """

    def __init__(self, family: type[Family]) -> None:
        self._shapes = (family.rows,), (family.rows, 6), (family.rows, family.size)
        self._arrays: list[list[Array]] = []
        self._capacity = -1

    def take(self, count: int) -> tuple[Linearisation, Linearisation]:
        """Two linearisations of `count` sightings, with anything in them."""
        if count > self._capacity:
            self._capacity = count + count // 4
            self._arrays = [[np.empty((self._capacity, *shape)) for shape in self._shapes]
                            for _ in range(2)]
        first, second = (Linearisation(*(part[:count] for part in arrays))
                         for arrays in self._arrays)
        return first, second


class Family(ABC):
    """Sightings sorted by landmark and frame, as rows of the landmarks and of the path."""

    rows: int              # residuals of a sighting
    size: int              # parameters of a landmark

    def __init__(self, sightings: PointObservations | LineObservations, prior: LandmarkPrior,
                 camera: Intrinsics, config: BundleConfig, room: Room) -> None:
        self.prior, self.config, self.camera = prior, config, camera_tuple(camera)
        self.pose, self.landmark = sightings.frame, sightings.landmark
        self.start = np.searchsorted(self.landmark, np.arange(len(prior.place) + 1))
        # (M, 3) of the first two residuals: lower L⁻¹; then 1/σ of each other one.
        self.whitening = self._whitening(sightings)
        self.uv_scale2 = self.rho_scale2 = 1.0
        self._share: Array | None = None         # (M,) of a sighting's information that counts
        self.now, self._trial = room.take(len(self.pose))
        self._inverse = np.empty_like(prior.information)
        self._gradient = np.empty(prior.information.shape[:2])

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def longest(self) -> int:
        """Frames from the first to the last sighting of a landmark, at most."""
        if len(self) == 0:
            return 1
        seen = np.flatnonzero(np.diff(self.start))
        return int(np.max(self.pose[self.start[seen + 1] - 1] - self.pose[self.start[seen]])) + 1

    def evaluate(self, T: Array, place: Array) -> float:
        """The objective at poses (F, 4, 4) and landmarks; `take_over` makes it the current."""
        trial = self._trial
        scale = np.full(self.whitening.shape[1], 1.0 / np.sqrt(self.rho_scale2))
        scale[:3] = 1.0 / np.sqrt(self.uv_scale2)
        cost = self._fill(T, place, self.whitening * scale, trial)
        if self._share is not None:
            cost = self._shared(trial, self._share)
        off = self.off(place, self.prior.place)
        trial.place, trial.pull = place, np.zeros_like(off)
        return cost + quadratic(off, self.prior.information, trial.pull)

    def take_over(self) -> None:
        """What was evaluated last becomes the point of linearisation."""
        self.now, self._trial = self._trial, self.now

    def reduce(self, damping: float, S: Array, g: Array) -> None:
        """Add the current linearisation, landmarks eliminated, to the poses' system."""
        now = self.now
        reduce_landmarks(self.pose, self.start, now.r, now.J, now.V, self.prior.information,
                         now.pull, damping, S, g, self._inverse, self._gradient)

    def steps(self, pose_steps: Array) -> Array:
        """(P, D) steps of the landmarks that go with steps (F, 6) of the poses."""
        return np.asarray(landmark_steps(self.pose, self.start, self.now.J, self.now.V,
                                         self._inverse, self._gradient, pose_steps))

    def condensed(self, leaving: Array) -> tuple[Array, Array]:
        """Information (P, D, D) and place of landmarks by the prior and some sightings.

        Args:
            leaving: (M,) bool: the sightings that count, their poses taken as they stand.
        """
        now, information = self.now, np.array(self.prior.information)
        step = condense(np.flatnonzero(leaving), self.landmark, now.r, now.V, information,
                        np.array(now.pull))
        return information, self.moved(now.place, step)

    def measure_noise(self) -> None:
        """Scale the assumed noise of pixels and of inverse depths to the current residuals.

        A landmark's own position takes up one sighting's worth of its residuals.
        """
        uv, rho = noise_ratios(self.start, self._whole_residuals(), self.now.chi2, self.whitening,
                               self.config.kernel_width)
        self.uv_scale2 = max(self.uv_scale2 * uv, _SMALLEST_SCALE2)
        self.rho_scale2 = max(self.rho_scale2 * rho, _SMALLEST_SCALE2)

    def measure_likeness(self) -> None:
        """Let a landmark's sightings count for less by how alike they err.

        Of n sightings whose errors correlate by c, each holds 1 / (1 + (n − 1) c) of what it would
        alone (Kish's design effect).
        """
        c = max(likeness(self.start, self._whole_residuals()), 0.0)
        count = np.diff(self.start)
        self._share = np.repeat(1.0 / (1.0 + c * (count - 1)), count)

    def _whole_residuals(self) -> Array:
        """(M, R) current ones, weighted by the kernel alone."""
        if self._share is None:
            return self.now.r
        return np.asarray(self.now.r / np.sqrt(self._share)[:, None])

    def _shared(self, filled: Linearisation, share: Array) -> float:
        """Weigh a linearisation's sightings by their shares; its cost then."""
        root, width2 = np.sqrt(share), self.config.kernel_width**2
        filled.r *= root[:, None]
        filled.J *= root[:, None, None]
        filled.V *= root[:, None, None]
        chi2 = np.minimum(filled.chi2, UNSEEN_CHI2)
        return float(width2 * np.sum(share * np.log1p(chi2 / width2)))

    def drop_misfits(self) -> float:
        """Leave out landmarks most of whose sightings fit no one place; what they cost.

        A patch on the edge of a thing moves with the thing while its depth is of what lies behind:
        all its sightings err to one side, and sighting by sighting the kernel keeps too much.
        """
        limit = self.config.misfit_chi2 * self.now.r.shape[1] / 3.0
        return float(drop_misfits(self.start, self.now.chi2, limit, self.config.kernel_width,
                                  self.whitening, self.now.r, self.now.J, self.now.V))

    def _whitening(self, sightings: PointObservations | LineObservations) -> Array:
        """(M, 1 + R) of pixels and inverse depths."""
        return np.asarray(whitening(sightings.covariance,
                                    sightings.rho_sigma.reshape(len(self.pose), self.rows - 2)))

    @abstractmethod
    def _fill(self, T: Array, place: Array, whitening: Array, out: Linearisation) -> float:
        """Fill a linearisation; its robust cost."""

    @abstractmethod
    def moved(self, place: Array, step: Array) -> Array:
        """Landmarks after steps (P, D)."""

    @abstractmethod
    def off(self, place: Array, held: Array) -> Array:
        """(P, D) step that leads from where landmarks are held to where they are."""


class PointFamily(Family):
    """Points (P, 3) in metres."""

    rows, size = 3, 3

    def __init__(self, sightings: PointObservations, prior: LandmarkPrior, camera: Intrinsics,
                 config: BundleConfig, room: Room) -> None:
        super().__init__(sightings, prior, camera, config, room)
        self._uv, self._rho = sightings.uv_px, sightings.rho

    def _fill(self, T: Array, place: Array, whitening: Array, out: Linearisation) -> float:
        cost, out.chi2 = linearise(T, place, self.pose, self.landmark, self._uv, self._rho,
                                   whitening, self.camera, self.config.kernel_width, out.r,
                                   out.J, out.V)
        return float(cost)

    def moved(self, place: Array, step: Array) -> Array:
        return place + step

    def off(self, place: Array, held: Array) -> Array:
        return place - held


class LineFamily(Family):
    """Lines (P, 10), as `slam.line_sightings` stores them."""

    rows, size = 4, 4

    def __init__(self, sightings: LineObservations, prior: LandmarkPrior, camera: Intrinsics,
                 config: BundleConfig, room: Room) -> None:
        super().__init__(sightings, prior, camera, config, room)
        self._ends, self._rho = sightings.ends_px, sightings.rho

    def _fill(self, T: Array, place: Array, whitening: Array, out: Linearisation) -> float:
        cost, out.chi2 = linearise_lines(T, place, self.pose, self.landmark, self._ends, self._rho,
                                         whitening, self.camera, self.config.kernel_width, out.r,
                                         out.J, out.V)
        return float(cost)

    def moved(self, place: Array, step: Array) -> Array:
        return np.asarray(moved_lines(place, step))

    def off(self, place: Array, held: Array) -> Array:
        return np.asarray(change_of_lines(held, place))


class PaperLineFamily(LineFamily):
    """Lines measured by eq. (5) as printed: distances of both observed ends, in metres."""

    rows, size = 2, 4

    def __init__(self, sightings: LineObservations, prior: LandmarkPrior, camera: Intrinsics,
                 config: BundleConfig, room: Room) -> None:
        self._ends_m, self._sigma_m = ends_in_metres(
            sightings.ends_px, sightings.covariance, sightings.rho, sightings.rho_sigma, camera)
        super().__init__(sightings, prior, camera, config, room)

    def measure_likeness(self) -> None:
        """Let all sightings count in full: lengths have no sign by which errors could be alike."""

    def _whitening(self, sightings: PointObservations | LineObservations) -> Array:
        """(M, 3) of the two distances; 0 where there is no depth, and so no distance."""
        known = np.asarray(np.isfinite(self._sigma_m).all(axis=1))
        out = np.zeros((len(known), 3))
        out[known, 0], out[known, 2] = 1.0 / self._sigma_m[known].T
        return out

    def _fill(self, T: Array, place: Array, whitening: Array, out: Linearisation) -> float:
        cost, out.chi2 = linearise_line_distances(T, place, self.pose, self.landmark, self._ends_m,
                                                  whitening, self.config.kernel_width, out.r,
                                                  out.J, out.V)
        return float(cost)


LINE_FAMILIES: Mapping[str, type[LineFamily]] = {"well_conditioned": LineFamily,
                                                 "paper": PaperLineFamily}
"""Families by `BundleConfig.line_form`."""
