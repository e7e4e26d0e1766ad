"""Bundle adjustment of one body: the camera's poses in its frame, and its landmarks.

Static world and rigid object alike (EQUATIONS 5, the object-centric formulation): each point and
each line is one variable for its whole life. The tracker's steps tie successive poses, with the
information that the tracker claims for them, and as their errors hang together
(slam.backend.step_errors).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam.backend.config import BundleConfig
from slam.backend.descend import levenberg_marquardt
from slam.backend.families import LINE_FAMILIES, Family, LandmarkPrior, PointFamily, Room
from slam.backend.pose_covariance import step_covariances
from slam.backend.pose_system import solve_poses
from slam.backend.step_errors import add_steps, cost_of_steps, roots, ties
from slam.factors import odometry_terms
from slam.geometry.arrays import Array
from slam.geometry.se3_rows import moved_rows
from slam.map import LineObservations, PointObservations, no_line_observations
from slam.types import Intrinsics

__all__ = ["BodyPath", "BundleResult", "LandmarkPrior", "Problem", "State", "bundle",
           "no_line_prior", "no_prior"]

UNKNOWN_STEP = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 1.0])   # 0.5 rad, 1 m: keeps gaps solvable
_NO_LINES = np.zeros((0, 10))


@dataclass(frozen=True, slots=True)
class BodyPath:
    """The camera's poses in a body's frame, as tracked."""

    T_body_camera: Array     # (F, 4, 4) where the batch starts
    steps: Array             # (F, 4, 4) as tracked, from the pose before; of the first: no matter
    information: Array       # (F, 6, 6) of each step; 0 where unknown
    correlation: float = 0.0   # of a step's error with the next one's


class State(NamedTuple):
    """A body's poses and landmarks."""

    T_body_camera: Array               # (F, 4, 4)
    xyz_body: Array                    # (P, 3) m
    lines_body: Array = _NO_LINES      # (L, 10), as slam.line_sightings stores them


def no_prior(landmarks: int) -> LandmarkPrior:
    """Nothing is held of points."""
    return LandmarkPrior(np.zeros((landmarks, 3, 3)), np.zeros((landmarks, 3)))


def no_line_prior(lines: Array) -> LandmarkPrior:
    """Nothing is held of lines (L, 10)."""
    return LandmarkPrior(np.zeros((len(lines), 4, 4)), lines)


@dataclass(frozen=True, slots=True)
class BundleResult:
    T_body_camera: Array     # (F, 4, 4)
    xyz_body: Array          # (P, 3) m
    lines_body: Array        # (L, 10)
    objective_before: float  # of the poses and landmarks given, and of those returned,
    objective: float         # both with the noise measured last
    uv_scale: float          # measured over assumed standard deviation of the points' pixels
    rho_scale: float         # and of their inverse depths
    step_covariance: Array | None = None   # (F, 6, 6) of the steps between poses, where asked for


def bundle(path: BodyPath, xyz_body: Array, sightings: PointObservations, camera: Intrinsics,
           config: BundleConfig, lines_body: Array = _NO_LINES,
           line_sightings: LineObservations | None = None) -> BundleResult:
    """Refine a body's poses and landmarks; the objective never ends above where it began.

    The first pose stays. Landmarks with fewer than `min_sightings` should be left out before.

    Args:
        xyz_body: (P, 3) where points start.
        sightings: sorted by landmark and frame; `landmark` and `frame` are rows of `xyz_body`
            and of the path.
        lines_body: (L, 10) where lines start.
        line_sightings: the same of lines.
    """
    problem = Problem(path, sightings, no_prior(len(xyz_body)), camera, config, line_sightings,
                      no_line_prior(lines_body))
    begin = State(np.array(path.T_body_camera), np.array(xyz_body), np.array(lines_body))
    state = begin
    for _ in range(config.rounds):
        state = levenberg_marquardt(problem, state, config)
        problem.measure_noise()
        problem.drop_misfits()
        problem.measure_likeness()
    state = levenberg_marquardt(problem, state, config)
    before, after = problem.objective(begin), problem.objective(state)
    if not after <= before:
        state, after = begin, before
    covariance = None
    if config.covariances:
        problem.linearise(state)
        covariance = step_covariances(problem.reduced(0.0)[0], state.T_body_camera)
    return BundleResult(*state, before, after, float(np.sqrt(problem.points.uv_scale2)),
                        float(np.sqrt(problem.points.rho_scale2)), covariance)


class Problem:
    """One body's sightings and steps, with their noise."""

    def __init__(self, path: BodyPath, sightings: PointObservations, prior: LandmarkPrior,
                 camera: Intrinsics, config: BundleConfig,
                 line_sightings: LineObservations | None = None,
                 line_prior: LandmarkPrior | None = None,
                 rooms: tuple[Room, Room] | None = None) -> None:
        """
        Args:
            rooms: memory for points and lines that an earlier problem has done with.
        """
        line_family = LINE_FAMILIES[config.line_form]
        point_room, line_room = (Room(PointFamily), Room(line_family)) if rooms is None else rooms
        self.points = PointFamily(sightings, prior, camera, config, point_room)
        self.lines = line_family(
            no_line_observations() if line_sightings is None else line_sightings,
            no_line_prior(_NO_LINES) if line_prior is None else line_prior, camera, config,
            line_room)
        self.families: tuple[Family, Family] = self.points, self.lines
        self.steps = np.array(path.steps[1:])
        information = np.array(path.information[1:])
        known = np.isfinite(information).all(axis=(1, 2)) & (
            np.einsum("fii->f", information) > 0)
        information[~known] = UNKNOWN_STEP
        self.root, self.ties = roots(information), ties(known, path.correlation)
        self.band = max(1 + self.ties.shape[1], *(family.longest for family in self.families))
        T = path.T_body_camera
        self._terms = self._trial_terms = odometry_terms(T[:-1], T[1:], self.steps)

    def objective(self, state: State) -> float:
        """The objective, robust; `take_over` makes this the point of linearisation."""
        T, xyz, lines = state
        self._trial_terms = odometry_terms(T[:-1], T[1:], self.steps)
        return (self.points.evaluate(T, xyz) + self.lines.evaluate(T, lines)
                + cost_of_steps(self._trial_terms.r, self.root, self.ties))

    def take_over(self) -> None:
        """Linearise where the objective was asked for last."""
        self._terms = self._trial_terms
        for family in self.families:
            family.take_over()

    def linearise(self, state: State) -> float:
        """Take a new point of linearisation; the objective there."""
        cost = self.objective(state)
        self.take_over()
        return cost

    def stepped(self, state: State, damping: float) -> State | None:
        """The state one damped step on; None where the system is singular."""
        S, g = self.reduced(damping)
        S[0] = 0.0                                      # the first pose stays
        S[0, 0], g[0] = np.eye(6), 0.0
        poses = solve_poses(S, g, damping)
        if poses is None:
            return None
        points, lines = (family.steps(poses) for family in self.families)
        if not (np.isfinite(points).all() and np.isfinite(lines).all()):
            return None
        return State(moved_rows(state.T_body_camera, poses),
                     self.points.moved(state.xyz_body, points),
                     self.lines.moved(state.lines_body, lines))

    def reduced(self, damping: float) -> tuple[Array, Array]:
        """The poses' normal equations S (F, B, 6, 6), upper blocks, and g (F, 6)."""
        F = len(self.steps) + 1
        S, g = np.zeros((F, self.band, 6, 6)), np.zeros((F, 6))
        for family in self.families:
            family.reduce(damping, S, g)
        add_steps(*self._terms, self.root, self.ties, S, g)
        return S, g

    def measure_noise(self) -> None:
        """Scale the assumed noise to the residuals at the point of linearisation."""
        for family in self.families:
            family.measure_noise()

    def measure_likeness(self) -> None:
        """Weigh landmarks by how alike their sightings err."""
        for family in self.families:
            family.measure_likeness()

    def drop_misfits(self) -> float:
        """Leave out landmarks most of whose sightings fit no one place; what they cost."""
        return sum(family.drop_misfits() for family in self.families)
