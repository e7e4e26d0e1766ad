"""Bundle adjustment of one body: the camera's poses in its frame, and its landmarks.

Static world and rigid object alike (EQUATIONS 5, the object-centric formulation): each landmark is
one variable for its whole life. The tracker's steps tie successive poses, with the information
that the tracker claims for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.backend.config import BundleConfig
from slam.backend.reduced import landmark_steps, linearise, reduce_landmarks, solve_poses
from slam.factors import PairTerms, odometry_terms
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import PointObservations
from slam.residuals import camera_tuple
from slam.types import Intrinsics

_MEDIAN_CHI2_1 = 0.4549
_MEDIAN_CHI2_2 = 1.3863
_MIN_FOR_SCALE = 50           # sightings from which a noise scale may be read
_SMALLEST_SCALE2 = 1e-6       # noise-free input must not make the system singular
_UNKNOWN_STEP = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 1.0])   # 0.5 rad, 1 m: keeps gaps solvable


@dataclass(frozen=True, slots=True)
class BodyPath:
    """The camera's poses in a body's frame, as tracked."""

    T_body_camera: Array     # (F, 4, 4) where the batch starts
    steps: Array             # (F, 4, 4) as tracked, from the pose before; of the first: no matter
    information: Array       # (F, 6, 6) of each step; 0 where unknown


@dataclass(frozen=True, slots=True)
class LandmarkPrior:
    """What is held of landmarks beside the sightings given."""

    information: Array       # (P, 3, 3) 1/m²
    xyz_body: Array          # (P, 3) m, where it would have them


def no_prior(landmarks: int) -> LandmarkPrior:
    """Nothing is held of them."""
    return LandmarkPrior(np.zeros((landmarks, 3, 3)), np.zeros((landmarks, 3)))


@dataclass(frozen=True, slots=True)
class BundleResult:
    T_body_camera: Array     # (F, 4, 4)
    xyz_body: Array          # (P, 3) m
    chi2: Array              # (M,) squared whitened length of each sighting's residual
    objective_before: float  # of the poses and landmarks given, and of those returned,
    objective: float         # both with the noise measured last
    uv_scale: float          # measured over assumed standard deviation of the pixels
    rho_scale: float         # and of the inverse depths


def bundle(path: BodyPath, xyz_body: Array, sightings: PointObservations, camera: Intrinsics,
           config: BundleConfig) -> BundleResult:
    """Refine a body's poses and landmarks; the objective never ends above where it began.

    The first pose stays. Landmarks with fewer than `min_sightings` should be left out before.

    Args:
        xyz_body: (P, 3) where landmarks start.
        sightings: sorted by landmark and frame; `landmark` and `frame` are rows of `xyz_body`
            and of the path.
    """
    problem = Problem(path, sightings, no_prior(len(xyz_body)), camera, config)
    T, xyz = np.array(path.T_body_camera), np.array(xyz_body)
    for _ in range(config.rounds):
        T, xyz = levenberg_marquardt(problem, T, xyz, config)
        problem.measure_noise(T, xyz)
        problem.drop_misfits(T, xyz)
    T, xyz = levenberg_marquardt(problem, T, xyz, config)
    before, _ = problem.objective(path.T_body_camera, xyz_body)
    after, chi2 = problem.objective(T, xyz)
    if not after <= before:
        T, xyz, after = np.array(path.T_body_camera), np.array(xyz_body), before
    return BundleResult(T, xyz, chi2, before, after, float(np.sqrt(problem.uv_scale2)),
                        float(np.sqrt(problem.rho_scale2)))


def levenberg_marquardt(problem: Problem, T: Array, xyz: Array,
                        config: BundleConfig) -> tuple[Array, Array]:
    """Damped steps; one that raises the objective is not taken."""
    damping = 1e-4
    cost = problem.linearise(T, xyz)
    for _ in range(config.iterations):
        step = problem.step(damping)
        if step is not None:
            T_try = T @ se3.exp(step[0])
            xyz_try = xyz + step[1]
            cost_try, _ = problem.objective(T_try, xyz_try)
        if step is None or not cost_try < cost:
            damping *= 30.0
            if damping > 1e6:
                break
            continue
        ended = cost - cost_try < config.tolerance * cost
        T, xyz = T_try, xyz_try
        damping = max(damping * 0.1, 1e-9)
        if ended:
            break
        cost = problem.linearise(T, xyz)
    return se3.orthonormalised(T), xyz


class Problem:
    """One body's sightings and steps, with their noise."""

    def __init__(self, path: BodyPath, sightings: PointObservations,
                 prior: LandmarkPrior, camera: Intrinsics, config: BundleConfig) -> None:
        s, landmarks = sightings, len(prior.xyz_body)
        self.prior = prior
        self.config, self.camera = config, camera_tuple(camera)
        self.pose, self.landmark = np.array(s.frame), np.array(s.landmark)
        self.uv, self.rho = np.array(s.uv_px), np.array(s.rho)
        self.start = np.searchsorted(self.landmark, np.arange(landmarks + 1))
        self.count = np.diff(self.start)[self.landmark]        # sightings of each one's landmark
        self.whitening = _whitening(s)
        self.uv_scale2 = self.rho_scale2 = 1.0
        m = len(s)
        self._work = np.zeros((m, 3)), np.zeros((m, 3, 6)), np.zeros((m, 3, 3))
        self._trial = np.zeros((m, 3)), np.zeros((m, 3, 6)), np.zeros((m, 3, 3))
        first = self.start[self.landmark]                      # each one's landmark's first
        self.band = int(np.max(self.pose - self.pose[first], initial=1)) + 1
        T = path.T_body_camera
        self.steps = np.array(path.steps[1:])
        self.information = np.array(path.information[1:])
        unknown = ~np.isfinite(self.information).all(axis=(1, 2)) | (
            np.einsum("fii->f", self.information) <= 0)
        self.information[unknown] = _UNKNOWN_STEP
        self._xyz = prior.xyz_body
        self._terms = odometry_terms(T[:-1], T[1:], self.steps)

    def _points(self, T: Array, xyz: Array, into: tuple[Array, Array, Array]
                ) -> tuple[float, Array]:
        scales = 1.0 / np.sqrt([self.uv_scale2, self.uv_scale2, self.uv_scale2, self.rho_scale2])
        return linearise(T, xyz, self.pose, self.landmark, self.uv, self.rho, 
                         self.whitening * scales, self.camera, self.config.kernel_width, *into)

    def objective(self, T: Array, xyz: Array) -> tuple[float, Array]:
        """The objective, and chi2 of each sighting."""
        cost, chi2 = self._points(T, xyz, self._trial)
        return cost + self._ties(odometry_terms(T[:-1], T[1:], self.steps), xyz), chi2

    def _ties(self, terms: PairTerms, xyz: Array) -> float:
        """What steps and priors cost."""
        off = xyz - self.prior.xyz_body
        return float(np.einsum("fi,fij,fj->", terms.r, self.information, terms.r)
                     + np.einsum("pi,pij,pj->", off, self.prior.information, off))

    def linearise(self, T: Array, xyz: Array) -> float:
        """Take a new point of linearisation; the objective there."""
        self._xyz = xyz
        cost, _ = self._points(T, xyz, self._work)
        self._terms = odometry_terms(T[:-1], T[1:], self.steps)
        return cost + self._ties(self._terms, xyz)

    def step(self, damping: float) -> tuple[Array, Array] | None:
        """Steps of poses (F, 6) and landmarks (P, 3), or None where the system is singular."""
        F, P = len(self.steps) + 1, len(self._xyz)
        S, g = np.zeros((F, self.band, 6, 6)), np.zeros((F, 6))
        inverse, gradient = np.zeros((P, 3, 3)), np.zeros((P, 3))
        rw, Jw, Vw = self._work
        known = self.prior.information
        pull = (known @ (self._xyz - self.prior.xyz_body)[:, :, None])[:, :, 0]
        reduce_landmarks(self.pose, self.start, rw, Jw, Vw, known, pull, damping, S, g, inverse,
                         gradient)
        self._add_steps(S, g)
        S[0] = 0.0                                      # the first pose stays
        S[0, 0], g[0] = np.eye(6), 0.0
        poses = solve_poses(S, g, damping)
        if poses is None:
            return None
        points = landmark_steps(self.pose, self.start, Jw, Vw, inverse, gradient, poses)
        return (poses, points) if np.isfinite(points).all() else None

    def _add_steps(self, S: Array, g: Array) -> None:
        terms = self._terms
        first = np.swapaxes(terms.J_first, 1, 2) @ self.information
        second = np.swapaxes(terms.J_second, 1, 2) @ self.information
        S[:-1, 0] += first @ terms.J_first
        S[1:, 0] += second @ terms.J_second
        S[:-1, 1] += first @ terms.J_second
        g[:-1] += (first @ terms.r[:, :, None])[:, :, 0]
        g[1:] += (second @ terms.r[:, :, None])[:, :, 0]

    def condensed(self, T: Array, xyz: Array, leaving: Array) -> tuple[Array, Array]:
        """Information (P, 3, 3) and place (P, 3) of landmarks by the prior and some sightings.

        Args:
            leaving: (M,) bool: the sightings that count, their poses taken as they stand.
        """
        self._points(T, xyz, self._trial)
        rw, _, Vw = self._trial
        index = np.flatnonzero(leaving)
        added = np.zeros((len(xyz), 3, 3))
        np.add.at(added, self.landmark[index], np.swapaxes(Vw[index], 1, 2) @ Vw[index])
        pull = np.zeros((len(xyz), 3))
        np.add.at(pull, self.landmark[index], np.einsum("mij,mi->mj", Vw[index], rw[index]))
        information = self.prior.information + added
        pull += np.einsum("pij,pj->pi", self.prior.information, xyz - self.prior.xyz_body)
        trace = np.einsum("pii->p", information)
        regular = information + (1e-9 * trace + 1e-12)[:, None, None] * np.eye(3)
        return information, xyz - np.linalg.solve(regular, pull[:, :, None])[:, :, 0]

    def measure_noise(self, T: Array, xyz: Array) -> None:
        """Scale the assumed noise of pixels and of inverse depths to the residuals.

        A landmark's own position takes up one sighting's worth of its residuals.
        """
        scales = self.uv_scale2, self.rho_scale2
        self.uv_scale2 = self.rho_scale2 = 1.0
        _, chi2 = self._points(T, xyz, self._trial)
        rw = self._trial[0]
        weight2 = 1.0 / (1.0 + chi2 / self.config.kernel_width**2)
        share = self.count / np.maximum(self.count - 1.0, 1.0)
        seen = np.isfinite(chi2) & (self.count >= 4) & (self.whitening[:, 0] > 0)
        if np.count_nonzero(seen) < _MIN_FOR_SCALE:
            self.uv_scale2, self.rho_scale2 = scales
            return
        square = rw[seen] ** 2 / weight2[seen, None] * share[seen, None]
        uv = float(np.median(square[:, 0] + square[:, 1])) / _MEDIAN_CHI2_2
        self.uv_scale2 = max(uv, _SMALLEST_SCALE2)
        known = self.whitening[seen, 3] > 0
        if np.count_nonzero(known) >= _MIN_FOR_SCALE:
            rho = float(np.median(square[known, 2])) / _MEDIAN_CHI2_1
            self.rho_scale2 = max(rho, _SMALLEST_SCALE2)
        else:
            self.rho_scale2 = scales[1]

    def drop_misfits(self, T: Array, xyz: Array) -> None:
        """Leave out landmarks most of whose sightings fit no one point.

        A patch on the edge of a thing moves with the thing while its depth is of what lies behind:
        all its sightings err to one side, and sighting by sighting the kernel keeps too much.
        """
        _, chi2 = self._points(T, xyz, self._trial)
        landmarks = len(self.start) - 1
        bad = np.bincount(self.landmark, chi2 > self.config.misfit_chi2, landmarks)
        misfit = bad > 0.5 * np.diff(self.start)
        self.whitening[misfit[self.landmark]] = 0.0


def _whitening(s: PointObservations) -> Array:
    """(M, 4): L⁻¹ (uu, vu, vv) of each pixel's covariance, and 1/σ of the inverse depth."""
    cov = s.covariance
    l00 = np.sqrt(cov[:, 0, 0])
    l10 = cov[:, 1, 0] / l00
    l11 = np.sqrt(np.maximum(cov[:, 1, 1] - l10**2, 1e-12))
    return np.stack([1.0 / l00, -l10 / (l00 * l11), 1.0 / l11, 1.0 / s.rho_sigma], axis=1)
