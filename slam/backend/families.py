"""Points and lines that a body's poses have seen: two kinds of landmarks, one interface.

A family holds its sightings, their noise, and what is held of its landmarks beside them. It is
evaluated at poses and landmarks, and adds itself to the poses' normal equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from slam.backend.config import BundleConfig
from slam.backend.linearise import condense, linearise, linearise_lines
from slam.backend.pose_system import quadratic
from slam.backend.reduced import landmark_steps, reduce_landmarks
from slam.geometry.arrays import Array
from slam.line_sightings import change_of_lines, moved_lines
from slam.map import LineObservations, PointObservations
from slam.residuals import camera_tuple
from slam.types import Intrinsics

_MEDIAN_CHI2_1 = 0.4549
_MEDIAN_CHI2_2 = 1.3863
_MIN_FOR_SCALE = 50           # sightings from which a noise scale may be read
_SMALLEST_SCALE2 = 1e-6       # noise-free input must not make the system singular


@dataclass(frozen=True, slots=True)
class LandmarkPrior:
    """What is held of landmarks beside the sightings given."""

    information: Array       # (P, D, D), D = 3: 1/m²; D = 4: of a line's four parameters
    place: Array             # (P, 3) m or (P, 10), where it would have them


class Linearisation:
    """A family at one point: weighted whitened residuals and derivatives."""

    def __init__(self, sightings: int, rows: int, size: int) -> None:
        self.r = np.zeros((sightings, rows))
        self.J = np.zeros((sightings, rows, 6))
        self.V = np.zeros((sightings, rows, size))
        self.chi2 = np.zeros(sightings)     # squared whitened length; inf where unseen
        self.place = np.zeros(0)            # of the landmarks
        self.pull = np.zeros((0, size))     # of the prior


class Family(ABC):
    """Sightings sorted by landmark and frame, as rows of the landmarks and of the path."""

    def __init__(self, sightings: PointObservations | LineObservations, prior: LandmarkPrior,
                 whitening: Array, rows: int, size: int, camera: Intrinsics,
                 config: BundleConfig) -> None:
        self.prior, self.config, self.camera = prior, config, camera_tuple(camera)
        self.pose, self.landmark = np.array(sightings.frame), np.array(sightings.landmark)
        self.start = np.searchsorted(self.landmark, np.arange(len(prior.place) + 1))
        self.whitening = whitening             # (M, 3) of the pixels: lower L⁻¹, then 1/σ of ρ
        self.uv_scale2 = self.rho_scale2 = 1.0
        self.now = Linearisation(len(self.pose), rows, size)
        self._trial = Linearisation(len(self.pose), rows, size)
        self._inverse = np.zeros((len(prior.place), size, size))
        self._gradient = np.zeros((len(prior.place), size))

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def longest(self) -> int:
        """Frames from the first to the last sighting of a landmark, at most."""
        if len(self) == 0:
            return 1
        first = self.start[self.landmark]
        return int(np.max(self.pose - self.pose[first])) + 1

    def evaluate(self, T: Array, place: Array) -> float:
        """The objective at poses (F, 4, 4) and landmarks; `take_over` makes it the current."""
        trial = self._trial
        scale = np.full(self.whitening.shape[1], 1.0 / np.sqrt(self.rho_scale2))
        scale[:3] = 1.0 / np.sqrt(self.uv_scale2)
        cost = self._fill(T, place, self.whitening * scale, trial)
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
        now = self.now
        information, pull = np.array(self.prior.information), np.array(now.pull)
        condense(np.flatnonzero(leaving), self.landmark, now.r, now.V, information, pull)
        trace = np.einsum("pii->p", information)
        regular = (information + (1e-9 * trace + 1e-12)[:, None, None]
                   * np.eye(information.shape[1]))
        return information, self.moved(now.place, -np.linalg.solve(regular, pull[:, :, None])[
            :, :, 0])

    def measure_noise(self) -> None:
        """Scale the assumed noise of pixels and of inverse depths to the current residuals.

        A landmark's own position takes up one sighting's worth of its residuals.
        """
        now = self.now
        count = np.diff(self.start)[self.landmark]
        seen = np.flatnonzero(np.isfinite(now.chi2) & (count >= 4) & (self.whitening[:, 0] > 0))
        if len(seen) < _MIN_FOR_SCALE:
            return
        weight2 = 1.0 / (1.0 + now.chi2[seen] / self.config.kernel_width**2)
        square = now.r[seen] ** 2 * (count[seen] / (count[seen] - 1.0) / weight2)[:, None]
        uv = float(np.median(square[:, 0] + square[:, 1])) / _MEDIAN_CHI2_2
        known = self.whitening[seen, 3] > 0
        if np.count_nonzero(known) >= _MIN_FOR_SCALE:
            rho = float(np.median(square[known, 2:])) / _MEDIAN_CHI2_1
            self.rho_scale2 = max(self.rho_scale2 * rho, _SMALLEST_SCALE2)
        self.uv_scale2 = max(self.uv_scale2 * uv, _SMALLEST_SCALE2)

    def drop_misfits(self) -> None:
        """Leave out landmarks most of whose sightings fit no one place.

        A patch on the edge of a thing moves with the thing while its depth is of what lies behind:
        all its sightings err to one side, and sighting by sighting the kernel keeps too much.
        """
        landmarks = len(self.start) - 1
        limit = self.config.misfit_chi2 * self.now.r.shape[1] / 3.0
        bad = np.bincount(self.landmark, self.now.chi2 > limit, landmarks)
        misfit = bad > 0.5 * np.diff(self.start)
        self.whitening[misfit[self.landmark]] = 0.0

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

    def __init__(self, sightings: PointObservations, prior: LandmarkPrior, camera: Intrinsics,
                 config: BundleConfig) -> None:
        whitening = np.column_stack([_whitening(sightings.covariance), 1.0 / sightings.rho_sigma])
        super().__init__(sightings, prior, whitening, 3, 3, camera, config)
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

    def __init__(self, sightings: LineObservations, prior: LandmarkPrior, camera: Intrinsics,
                 config: BundleConfig) -> None:
        whitening = np.column_stack([_whitening(sightings.covariance), 1.0 / sightings.rho_sigma])
        super().__init__(sightings, prior, whitening, 4, 4, camera, config)
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


def _whitening(cov: Array) -> Array:
    """(M, 3): L⁻¹ (00, 10, 11) of covariances (M, 2, 2)."""
    l00 = np.sqrt(cov[:, 0, 0])
    l10 = cov[:, 1, 0] / l00
    l11 = np.sqrt(np.maximum(cov[:, 1, 1] - l10**2, 1e-12))
    return np.stack([1.0 / l00, -l10 / (l00 * l11), 1.0 / l11], axis=1)
