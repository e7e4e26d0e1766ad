"""Camera pose and object motions from points and lines: eq. (3) and (4) in one solver.

All rigid motions between two frames, the camera's against the static world and each object's, are
solved together; each feature names its group. Each round renews the noise scales, the covariances
and the eliminated depths, then runs Levenberg-Marquardt with a robust kernel on what elimination
leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np

from slam.config import MotionConfig
from slam.estimation.covariance import clustering
from slam.estimation.kernel import KernelEffect, kernel_effect
from slam.estimation.line_family import LineFamily
from slam.estimation.point_family import PointFamily
from slam.estimation.tiles import tiles
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.spread import MEDIAN_CHI2_1
from slam.types import Intrinsics

_SMALLEST_SCALE2 = 1e-8         # noise-free input must not make the systems singular
_MIN_FOR_SCALE = 30            # features from which a noise scale may be read
_LINE_PRIOR = 30               # distances of line ends that earlier frames' noise counts for
_SAMPLE = 1000                 # points of a motion are enough for medians and first steps
_TILES = (4, 8)                # rows and columns of tiles with a depth noise of their own
_TILE_PRIOR = 6                # features that the whole image's noise counts for in a tile
_PARTS = (3, 4)                # rows and columns of parts over which errors hang together
_TESTED = 0.1                  # share of a depth's variance that its residuals can explain


@dataclass(frozen=True)
class Motions:
    """The solution of G rigid motions between two frames."""

    T_a_b: Array              # (G, 4, 4) pose of camera b in a, as each rigid body sees it
    information: Array        # (G, 6, 6) of T_a_b Exp(ξ)
    point_chi: Array          # (N,) whitened length of each point's residual (3 rows, or 2)
    line_chi: Array           # (L,) the same of each line (2 rows)
    flow_scale: Array         # (G, kinds) measured over assumed standard deviation of the flow
    line_scale: float         # the same of the lines'
    depth_scale: float        # the same of the inverse depths
    clustering: float         # of the camera's errors, as slam.estimation.covariance has it
    points: PointFamily       # as they were left, for what was eliminated
    lines: LineFamily

    @cached_property
    def refined_uv_b(self) -> Array:
        """(N, 2) px: m + φ with the optimised flow of eq. (3)."""
        return self.points.refined_uv_b(self.T_a_b)

    @cached_property
    def refined_endpoints_b(self) -> Array:
        """(L, 2, 2) px: a + φ_a and b + φ_b with the optimised flows."""
        return self.lines.refined_endpoints_b(self.T_a_b)

    @cached_property
    def depth_offset(self) -> tuple[float, float]:
        """1/m, of all static inverse depths, and its standard deviation."""
        return self.points.common_offset(self.T_a_b, group=0)


@dataclass(frozen=True, slots=True)
class NoiseScales:
    """Measured over assumed standard deviations: where the next frame starts."""

    flow: Array               # (kinds,)
    lines: float = 1.0
    depth: float = 1.0
    clustering: float = 1.0   # of variances: near features err alike
    common_depth: float = 2e-4   # 1/m, what a part's inverse depths err by together: stereo


def refine_motions(T_a_b: Array, points: PointMatches, lines: LineMatches, camera: Intrinsics,
                   config: MotionConfig, scales: NoiseScales, adapt: bool = True) -> Motions:
    """Minimise eq. (3) for the camera (group 0) and eq. (4) for each object (groups 1 …).

    Args:
        T_a_b: (G, 4, 4) where to start, one for each group that the matches name.
        scales: noise relative to what the matches carry, from earlier frames.
        adapt: measure the noise again on this frame's residuals.
    """
    problem = _Problem(points, lines, len(T_a_b), camera, config, scales)
    T = np.array(T_a_b, dtype=np.float64)
    information = np.zeros((len(T), 6, 6))
    for remaining in reversed(range(config.rounds)):
        problem.renew(T)
        # A sample takes the first rounds near enough.
        T, information = _levenberg_marquardt(problem, T, config,
                                              problem.sample if remaining else None)
        if adapt:
            problem.measure_noise(T)
    return problem.solution(T, information)


def _levenberg_marquardt(problem: _Problem, T: Array, config: MotionConfig,
                         index: Array | None = None) -> tuple[Array, Array]:
    """A few damped steps on all groups at once; a step that raises a group's cost is not taken.

    Args:
        index: the points that count; None: all.
    """
    damping = np.full(len(T), 1e-6)
    cost, H, g = problem.linearise(T, index)
    for _ in range(config.iterations):
        diagonal = np.einsum("gii->gi", H)
        damped = H + (damping[:, None] * diagonal + 1e-12)[:, :, None] * np.eye(6)
        step = -np.linalg.solve(damped, g[:, :, None])[:, :, 0]
        # The step's length in standard deviations says when there is nothing left to gain.
        if np.all(np.einsum("gi,gij,gj->g", step, H, step) < config.step_tolerance**2):
            break
        T_try = T @ se3.exp(step)
        cost_try, H_try, g_try = problem.linearise(T_try, index)
        better = cost_try <= cost
        T = np.where(better[:, None, None], T_try, T)
        H = np.where(better[:, None, None], H_try, H)
        g = np.where(better[:, None], g_try, g)
        cost = np.where(better, cost_try, cost)
        damping = np.where(better, damping * 0.1, np.minimum(damping * 100.0, 1e6))
    return T, H


class _Problem:
    """Both families, and the noise scales that this frame's residuals tell."""

    def __init__(self, points: PointMatches, lines: LineMatches, groups: int, camera: Intrinsics,
                 config: MotionConfig, scales: NoiseScales) -> None:
        self.groups = groups
        self.points = PointFamily(points, camera, config)
        self.lines = LineFamily(lines, camera, config)
        self.flow_scale2 = np.repeat(np.asarray(scales.flow)[None] ** 2, groups, axis=0)
        self.line_scale2, self.depth_scale2 = scales.lines**2, scales.depth**2
        # Depth is good on a road and bad in a tree: its noise is measured tile by tile.
        self.camera = camera
        self.point_tile = tiles(points.uv_a, points.group, camera, _TILES)
        self.line_tile = tiles(lines.endpoints_a.mean(axis=1), lines.group, camera, _TILES)
        self.tile_scale2 = np.full(_TILES[0] * _TILES[1] + groups - 1, self.depth_scale2)
        self.sample = _evenly_spread(points.group, points.kind)

    def renew(self, T: Array) -> None:
        """New covariances and eliminated depths at T."""
        m = self.points.m
        self.points.flow_scale2 = self.flow_scale2[m.group, m.kind]
        self.points.depth_scale2 = self.tile_scale2[self.point_tile]
        self.lines.depth_scale2 = self.tile_scale2[self.line_tile]
        self.lines.flow_scale2 = self.line_scale2
        self.points.renew(T)
        self.lines.renew(T)

    def linearise(self, T: Array, index: Array | None = None) -> tuple[Array, Array, Array]:
        """Robust cost (G,), normal matrices (G, 6, 6) and gradients (G, 6) at T.

        Args:
            index: the points that count; None: all.
        """
        system = np.zeros(self.groups), np.zeros((self.groups, 6, 6)), np.zeros((self.groups, 6))
        self.points.accumulate(T, *system, index=index)
        self.lines.accumulate(T, *system)
        return system

    def measure_noise(self, T: Array) -> None:
        """Scale the assumed noise to the residuals: points' flow by group and kind, depth and
        lines' flow by all."""
        r, j = self.points.marginal(T, self.sample)
        self._measure_flow_noise(r, j)
        self._measure_line_noise(T)
        self._measure_depth_noise(r, j)

    def _measure_flow_noise(self, r: Array, j: Array) -> None:
        """The scale s² for which the median of r² / (s² Σ_φ + depth part) is that of χ²₁."""
        f, sample = self.points, self.sample
        kinds = self.flow_scale2.shape[1]
        now2 = self.flow_scale2.ravel()
        class_of = np.repeat(f.m.group[sample] * kinds + f.m.kind[sample], 2)      # u and v
        depth_part = (j[:, :2] ** 2 * (f.var_a * f.depth_scale2)[sample, None]).ravel()
        flow_part = f.flow_cov[sample][:, [0, 1], [0, 1]].ravel()
        ratio = r[:, :2].ravel() ** 2 / (now2[class_of] * flow_part + depth_part)
        ratio, count = _grouped_median(ratio, class_of, len(now2))
        flow, _ = _grouped_median(flow_part, class_of, len(now2))
        depth, _ = _grouped_median(depth_part, class_of, len(now2))
        scale2 = _rescaled(now2, ratio / MEDIAN_CHI2_1, np.where(count > 0, flow, 1.0), depth)
        measured = (count >= 2 * _MIN_FOR_SCALE).reshape(-1, kinds)
        scale2 = np.where(measured, scale2.reshape(-1, kinds), self.flow_scale2)
        # Too few to tell: the static world's flow has the same source.
        self.flow_scale2 = np.where(measured, scale2, scale2[0])

    def _measure_line_noise(self, T: Array) -> None:
        """The same of lines: few, so that earlier frames' noise counts beside this one's."""
        own = self.lines.m.group == 0
        if not own.any():
            return
        now2 = np.asarray(self.line_scale2)
        r, flow, rest = (each[own].ravel() for each in self.lines.marginal(T))
        ratio = np.median(r**2 / (now2 * flow + rest)) / MEDIAN_CHI2_1
        scale2 = _rescaled(now2, ratio, np.median(flow), np.median(rest))
        self.line_scale2 = float((len(r) * scale2 + _LINE_PRIOR * now2) / (len(r) + _LINE_PRIOR))

    def _measure_depth_noise(self, r: Array, j: Array) -> None:
        """How far the eliminated depths moved, over what their noise allows: by tile and in all."""
        f, sample = self.points, self.sample
        moved, allowed = f.depth_innovation(r, j, sample)
        before = f.depth_scale2[sample]
        # A depth that neither parallax nor the second frame tests says nothing.
        tested = np.flatnonzero(allowed > _TESTED * f.var_a[sample] * before)
        static = f.m.group[sample[tested]] == 0
        if np.count_nonzero(static) < _MIN_FOR_SCALE:
            return
        square = moved[tested] ** 2 / allowed[tested] * before[tested] / MEDIAN_CHI2_1
        self.depth_scale2 = max(float(np.median(square[static])), _SMALLEST_SCALE2)
        medians, count = _grouped_median(square, self.point_tile[sample[tested]],
                                         len(self.tile_scale2))
        blended = (count * medians + _TILE_PRIOR * self.depth_scale2) / (count + _TILE_PRIOR)
        self.tile_scale2 = np.maximum(blended, _SMALLEST_SCALE2)

    def solution(self, T: Array, information: Array) -> Motions:
        # Part by part of the image; an object is one part.
        points, lines, parts = self.points.m, self.lines.m, _PARTS[0] * _PARTS[1]
        pose = T[np.r_[np.zeros(parts, np.int64), np.arange(1, self.groups)]]
        n = len(pose)
        _, H, g = sums = np.zeros(n), np.zeros((n, 6, 6)), np.zeros((n, 6))
        point_chi = self.points.accumulate(
            pose, *sums, part=tiles(points.uv_a, points.group, self.camera, _PARTS))
        line_chi = self.lines.accumulate(
            pose, *sums, part=tiles(lines.endpoints_a.mean(axis=1), lines.group, self.camera,
                                     _PARTS))
        effect = self._kernel_effect(point_chi, line_chi)
        return Motions(T, information * effect.efficiency[:, None, None], point_chi, line_chi,
                       np.sqrt(self.flow_scale2), float(np.sqrt(self.line_scale2)),
                       float(np.sqrt(self.depth_scale2)),
                       clustering(H[:parts], g[:parts] / np.sqrt(effect.score[0])),
                       self.points, self.lines)

    def _kernel_effect(self, point_chi: Array, line_chi: Array) -> KernelEffect:
        """By motion, from all residuals."""
        m, config = self.points.m, self.points.config
        rows = np.r_[np.where(self.points.known_b, 3.0, 2.0), np.full(len(line_chi), 2.0)]
        return kernel_effect(np.r_[point_chi, line_chi] ** 2, rows,
                             np.r_[m.group, self.lines.m.group], self.groups,
                             config.kernel == "huber", config.kernel_width)


def _rescaled(now2: Array, ratio: Array, flow: Array, rest: Array) -> Array:
    """Scales s² of variances with s² flow + rest = ratio · (now2 flow + rest), as far as s² > 0."""
    scale2 = (ratio * (now2 * flow + rest) - rest) / flow
    floor = np.maximum(0.01 * now2 * np.minimum(ratio, 1.0), _SMALLEST_SCALE2)
    return np.asarray(np.maximum(scale2, floor))


def _evenly_spread(group: Array, kind: Array) -> Array:
    """Numbers (M,) of points that stand for all: `_SAMPLE` to twice as many of a large group,
    its kinds in proportion."""
    order = np.lexsort((kind, group))
    count = np.bincount(group)
    rank = np.arange(len(order)) - (np.cumsum(count) - count)[group[order]]
    return np.asarray(order[rank % np.maximum(count // _SAMPLE, 1)[group[order]] == 0])


@numba.njit(cache=True, nogil=True)
def _grouped_median(values, group, groups):  # type: ignore[no-untyped-def]
    """Median (the upper of two; 0 where empty) and count of values (N,) by group number."""
    count = np.zeros(groups, np.int64)
    for g in group:
        count[g] += 1
    end = np.cumsum(count)
    fill = end - count
    ordered = np.empty(len(values))
    for i in range(len(values)):
        ordered[fill[group[i]]] = values[i]
        fill[group[i]] += 1
    medians = np.zeros(groups)
    for g in range(groups):
        if count[g] > 0:
            own = ordered[end[g] - count[g]: end[g]]
            medians[g] = np.partition(own, count[g] // 2)[count[g] // 2]
    return medians, count
