"""The global batch in the paper's own formulation, eq. (5) and (6).

Variables: the camera's pose in each frame, the motion H of each object to each frame, static
points and lines once, dynamic points and lines once in every frame. Factors: 3D measurement of
points and lines, odometry, motion of points and lines, smooth motion of objects. Landmarks are
eliminated along their chains, then each object's motions; the camera's poses are what is left.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular

from slam.backend.bundle import UNKNOWN_STEP
from slam.backend.chain_families import (
    Chains,
    LineChains,
    PointChains,
    identity_motions,
    motions_of,
)
from slam.backend.config import BundleConfig, ChainConfig
from slam.backend.descend import levenberg_marquardt
from slam.backend.pose_system import one_thread
from slam.backend.refine_run import of_body, static_segments, with_covariances, with_paths
from slam.factors import PairTerms, odometry_terms, smooth_motion_terms
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import STATIC, BodyRecord, MapRecord
from slam.types import Intrinsics, SlamResult

_LEAST_RIGIDITY = 0.1
_SHORTEST_S = 1e-4         # between frames: stamps that stand still must not make ties infinite
_SMALLEST_RATIO = 1e-3     # noise-free input must not make the system singular


class State(NamedTuple):
    """Cameras, motions and landmarks of a run: all that the batch moves."""

    X: Array                     # (F, 4, 4) T_world_camera
    H: tuple[Array, ...]         # of each body (f, 4, 4)
    place: tuple[tuple[Array, ...], ...]   # of each body, its points' and its lines' nodes


class Covariances(NamedTuple):
    """Of what the batch has found; tangents [ω, v] on the right, NaN: not known."""

    steps: Array                 # (F, 6, 6) of the cameras' steps X_{k−1}⁻¹ X_k
    motions: dict[int, Array]    # body -> (f, 6, 6) of H, the camera's pose before it given


class _Body:
    """One body's chains, in the numbering of its own frames."""

    def __init__(self, body: BodyRecord, number: int, record: MapRecord, camera: Intrinsics,
                 bundle: BundleConfig, config: ChainConfig, interval_s: float) -> None:
        # What bends is tied the more loosely, and so pulls the cameras less.
        rigidity = max(float(np.mean(body.rigidity)), _LEAST_RIGIDITY)
        config = replace(config, motion_sigma_m=config.motion_sigma_m / rigidity**2)
        self.moving = number != STATIC
        self._smooth_weight = 1.0 / np.repeat(
            [config.angular_acceleration_rad_s2 * interval_s**2,
             config.acceleration_m_s2 * interval_s**2], 3)
        self.at = np.searchsorted(record.bodies[STATIC].frames, body.frames)
        X = np.array(record.bodies[STATIC].poses)[self.at]
        self.T_world_body = X @ se3.inverse(np.array(body.poses))
        self.H = motions_of(self.T_world_body) if self.moving else identity_motions(len(self.at))
        self.centroid = self.T_world_body[:, :3, 3]
        points, s = of_body(record.points, body, number, bundle)
        lines, line_s = of_body(record.lines, body, number, bundle)
        self.families: list[Chains] = [
            PointChains(s, len(points), self.moving, camera, config),
            LineChains(line_s, len(lines), self.moving, camera, config)]
        place = [family.place(landmarks, self.T_world_body)
                 for family, landmarks in zip(self.families, (points, lines), strict=True)]
        self.place = tuple(place)

    def smooth(self, H: Array) -> PairTerms:
        """Change between successive motions, whitened."""
        t = smooth_motion_terms(H[1:-1], H[2:], self.centroid[:-2], self.centroid[1:-1])
        w = self._smooth_weight
        return PairTerms(w * t.r, w[:, None] * t.J_first, w[:, None] * t.J_second)

    def cost(self, X: Array, H: Array, place: tuple[Array, ...]) -> float:
        own = sum(f.cost(X[self.at], H, p) for f, p in zip(self.families, place, strict=True))
        return own + self._smooth_cost(H)

    def linearise(self, X: Array, H: Array, place: tuple[Array, ...]) -> None:
        for family, own in zip(self.families, place, strict=True):
            family.linearise(X[self.at], H, own)
        self._smooth = self.smooth(H) if self.moving else None

    def _smooth_cost(self, H: Array) -> float:
        return float(np.sum(self.smooth(H).r ** 2)) if self.moving else 0.0

    def reduced(self, damping: float) -> tuple[Array, Array]:
        """What this body's chains, and then its motions, leave of its cameras: (6f, 6f), (6f,).

        Before, unknowns are its f cameras, then the f motions that lead to its frames.
        """
        f = len(self.at)
        S, g = np.zeros((12 * f, 12 * f)), np.zeros(12 * f)
        for family in self.families:
            family.add(damping, S, g)
        if not self.moving:
            return S[:6 * f, :6 * f], g[:6 * f]
        assert self._smooth is not None
        _add_pairs(self._smooth, np.arange(f + 1, 2 * f - 1), S, g)
        # No motion leads to the first frame.
        cameras, motions = slice(0, 6 * f), slice(6 * f + 6, 12 * f)
        K = S[motions, motions]
        # What nothing tells of a motion stays as it is.
        K[np.diag_indices_from(K)] += damping * np.diag(K) + 1e-6
        factor = np.linalg.cholesky(K)
        W = solve_triangular(factor, np.c_[S[motions, cameras], g[motions]], lower=True)
        self._eliminated = factor, W
        return (S[cameras, cameras] - W[:, :-1].T @ W[:, :-1],
                g[cameras] - W[:, :-1].T @ W[:, -1])

    def covariances(self, X: Array, H: Array, of_cameras: Array) -> Array:
        """(f, 6, 6) of the motions H, once `reduced`, from those (6F, 6F) of all cameras X."""
        f = len(self.at)
        at = (6 * self.at[:, None] + np.arange(6)).reshape(-1)
        factor, W = self._eliminated
        own = solve_triangular(factor, np.eye(len(factor)), lower=True)
        A = -own.T @ W[:, :-1]                       # steps of the motions, by those of the cameras
        both = A @ of_cameras[np.ix_(at, at)]
        before = X[self.at[:-1]]
        # What the world is off by turns the motion with it: H Exp(ξ_H + (Ad X − Ad H⁻¹ X) ξ_X).
        turned = se3.adjoint(before) - se3.adjoint(se3.inverse(H[1:]) @ before)
        out = np.full((f, 6, 6), np.nan)
        for k in range(f - 1):
            motion, camera = slice(6 * k, 6 * k + 6), at[6 * k:6 * k + 6]
            cross = both[motion, motion] @ turned[k].T
            out[k + 1] = (own[:, motion].T @ own[:, motion] + both[motion] @ A[motion].T + cross
                          + cross.T + turned[k] @ of_cameras[np.ix_(camera, camera)] @ turned[k].T)
        return out

    def steps(self, poses: Array) -> tuple[Array, list[Array]]:
        """Steps of the motions (f, 6) and of the nodes, from those of all cameras (F, 6)."""
        f = len(self.at)
        steps = np.zeros((2 * f, 6))
        steps[:f] = poses[self.at]
        if self.moving:
            factor, W = self._eliminated
            right = -W[:, -1] - W[:, :-1] @ steps[:f].reshape(-1)
            steps[f + 1:] = solve_triangular(factor.T, right, lower=False).reshape(-1, 6)
        return steps[f:], [family.steps(steps) for family in self.families]


class ChainedProblem:
    """All bodies of a run, whose frames are `interval_s` apart."""

    def __init__(self, record: MapRecord, camera: Intrinsics, bundle: BundleConfig,
                 config: ChainConfig, interval_s: float) -> None:
        static = record.bodies[STATIC]
        self.numbers = [n for n, body in record.bodies.items() if len(body.frames) > 1]
        self.bodies = [_Body(record.bodies[n], n, record, camera, bundle, config, interval_s)
                       for n in self.numbers]
        self.begin = State(np.array(static.poses), tuple(b.H for b in self.bodies),
                           tuple(b.place for b in self.bodies))
        self._tried = self.begin
        self._odometry = np.array(static.steps[1:])
        # Neighbouring steps' errors hang together; here, only what that does to long ways counts.
        information = (np.array(static.information[1:]) * np.array(static.weight[1:])[:, None, None]
                       / (1.0 + 2.0 * record.step_correlation))
        unknown = ~np.isfinite(information).all(axis=(1, 2)) | (
            np.einsum("fii->f", information) <= 0)
        information[unknown] = UNKNOWN_STEP
        self._root = np.swapaxes(np.linalg.cholesky(information), 1, 2)

    def _steps_of(self, X: Array) -> PairTerms:
        t = odometry_terms(X[:-1], X[1:], self._odometry)
        return PairTerms((self._root @ t.r[:, :, None])[:, :, 0], self._root @ t.J_first,
                         self._root @ t.J_second)

    def objective(self, state: State) -> float:
        """What all factors cost; `take_over` linearises there."""
        self._tried = state
        return float(np.sum(self._steps_of(state.X).r ** 2)) + sum(
            b.cost(state.X, H, place)
            for b, H, place in zip(self.bodies, state.H, state.place, strict=True))

    def take_over(self) -> None:
        """Linearise where the objective was asked for last."""
        state = self._tried
        self._pairs = self._steps_of(state.X)
        for body, H, place in zip(self.bodies, state.H, state.place, strict=True):
            body.linearise(state.X, H, place)

    def _reduced(self, damping: float) -> tuple[Array, Array]:
        """The cameras' normal equations (6F, 6F), (6F,). Raises LinAlgError."""
        F = len(self._tried.X)
        S, g = np.zeros((6 * F, 6 * F)), np.zeros(6 * F)
        _add_pairs(self._pairs, np.arange(F - 1), S, g)
        for body in self.bodies:
            own, gradient = body.reduced(damping)
            at = (6 * body.at[:, None] + np.arange(6)).reshape(-1)
            S[np.ix_(at, at)] += own
            g[at] += gradient
        return S, g

    def covariances(self, state: State) -> Covariances:
        """Of the cameras' steps and the objects' motions; NaN where the system is singular."""
        self.objective(state)
        self.take_over()
        F = len(state.X)
        unknown = {n: np.full((len(b.at), 6, 6), np.nan)
                   for n, b in zip(self.numbers, self.bodies, strict=True) if b.moving}
        P = np.zeros((6 * F, 6 * F))                    # the first pose is held
        try:
            with one_thread():
                S, _ = self._reduced(0.0)
                P[6:, 6:] = cho_solve(cho_factor(S[6:, 6:], lower=True), np.eye(6 * F - 6))
                motions = {n: b.covariances(state.X, H, P) for n, b, H in
                           zip(self.numbers, self.bodies, state.H, strict=True) if b.moving}
        except (LinAlgError, np.linalg.LinAlgError, ValueError):
            return Covariances(np.full((F, 6, 6), np.nan), unknown)
        back = -se3.adjoint(se3.inverse(state.X[1:]) @ state.X[:-1])
        steps = np.full((F, 6, 6), np.nan)
        for k in range(F - 1):
            J = np.c_[back[k], np.eye(6)]
            both = slice(6 * k, 6 * k + 12)
            steps[k + 1] = J @ P[both, both] @ J.T
        return Covariances(steps, motions)

    def stepped(self, state: State, damping: float) -> State | None:
        """The state one damped step on; None where the system is singular."""
        F = len(state.X)
        try:
            with one_thread():
                S, g = self._reduced(damping)
                S[np.diag_indices_from(S)] += damping * np.abs(np.diag(S)) + 1e-12
                poses = np.zeros((F, 6))                    # the first pose stays
                poses[1:] = -cho_solve(cho_factor(S[6:, 6:], lower=True), g[6:]).reshape(-1, 6)
                found = [body.steps(poses) for body in self.bodies]
        except (LinAlgError, np.linalg.LinAlgError, ValueError):
            return None
        return State(
            se3.orthonormalised(state.X @ se3.exp(poses)),
            tuple(se3.orthonormalised(H @ se3.exp(step))
                  for H, (step, _) in zip(state.H, found, strict=True)),
            tuple(tuple(family.moved(p, d) for family, p, d in
                        zip(b.families, place, steps, strict=True))
                  for b, place, (_, steps) in zip(self.bodies, state.place, found, strict=True)))

    def settle(self, state: State, config: BundleConfig) -> None:
        """Measure the noise on the static world, and leave out what does not fit.

        A node of its own in every frame takes up what is measured there: of dynamic landmarks it
        is asked whether they fit the rigid body that they begin with.
        """
        static = self.numbers.index(STATIC)
        ratios = [family.noise(state.X, place) for family, place in
                  zip(self.bodies[static].families, state.place[static], strict=True)]
        for i, body in enumerate(self.bodies):
            at = state if i == static else self.begin
            for family, place, (uv, rho) in zip(body.families, at.place[i], ratios, strict=True):
                family.scale_noise(max(uv, _SMALLEST_RATIO), max(rho, _SMALLEST_RATIO))
                family.drop_misfits(at.X[body.at], place, config.misfit_chi2)


def solve(problem: ChainedProblem, config: BundleConfig) -> tuple[State, float, float]:
    """The state, and the objective of where the problem began and of it, by the noise found last.

    The objective never ends above where it began.
    """
    state = problem.begin
    for _ in range(config.rounds):
        state = levenberg_marquardt(problem, state, config)
        problem.settle(state, config)
    state = levenberg_marquardt(problem, state, config)
    before, after = problem.objective(problem.begin), problem.objective(state)
    return (state, before, after) if after <= before else (problem.begin, before, before)


def refine_chained(record: MapRecord, tracked: SlamResult, camera: Intrinsics,
                   bundle: BundleConfig, config: ChainConfig) -> SlamResult:
    """The run's result with poses and object motions after the batch, in the paper's form.

    Args:
        tracked: the result as tracked, over the same rows.
    """
    start = perf_counter()
    if len(record.bodies[STATIC].frames) < 2:
        return tracked
    interval_s = max(float(np.median(np.diff(tracked.stamps_s))), _SHORTEST_S)
    problem = ChainedProblem(record, camera, bundle, config, interval_s)
    state, _, _ = solve(problem, bundle)
    paths = {}
    for number, body, H in zip(problem.numbers, problem.bodies, state.H, strict=True):
        L = [body.T_world_body[0]]
        for motion in H[1:]:
            L.append(se3.orthonormalised(motion @ L[-1]))
        paths[number] = se3.inverse(np.array(L)) @ state.X[body.at]
    static = problem.numbers.index(STATIC)
    points, lines = state.place[static]
    made = replace(with_paths(record, tracked, paths), points_world=points,
                   lines_world=static_segments(record, state.X, lines, camera, bundle))
    if bundle.covariances:
        made = with_covariances(made, record, *problem.covariances(state))
    return replace(made, timings_ms=dict(made.timings_ms)
                   | {"global batch": 1e3 * (perf_counter() - start)})


def _add_pairs(terms: PairTerms, variable: Array, S: Array, g: Array) -> None:
    """Add whitened residuals that tie each variable to the next one."""
    for n, v in enumerate(variable):
        both = slice(6 * v, 6 * v + 12)
        J = np.c_[terms.J_first[n], terms.J_second[n]]
        S[both, both] += J.T @ J
        g[both] += J.T @ terms.r[n]
