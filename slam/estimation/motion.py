"""Camera pose and object motions from points and lines: eq. (3) and (4) in one solver.

All rigid motions between two frames, the camera's against the static world and each object's, are
solved together: features are sorted by group, and only the 6×6 systems are looped over. Each
round renews the noise scales, the covariances and the eliminated depths, then runs
Levenberg-Marquardt with a robust kernel on what elimination leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.config import MotionConfig
from slam.estimation.elimination import LineFamily, PointFamily
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches, take
from slam.types import Intrinsics

_MEDIAN_CHI2_1 = 0.4549        # median of χ² with one degree of freedom
_SMALLEST_SCALE2 = 1e-8        # noise-free input must not make the systems singular
_MIN_FOR_SCALE = 30            # features from which a noise scale may be read
_TILES = (4, 8)                # rows and columns of tiles with a depth noise of their own
_TESTED = 0.1                  # share of a depth's variance that its residuals can explain


@dataclass(frozen=True, slots=True)
class Motions:
    """The solution of G rigid motions between two frames."""

    T_a_b: Array              # (G, 4, 4) pose of camera b in a, as each rigid body sees it
    information: Array        # (G, 6, 6) of T_a_b Exp(ξ)
    point_chi: Array          # (N,) whitened length of each point's residual (3 rows, or 2)
    line_chi: Array           # (L,) the same of each line (2 rows)
    flow_scale: Array         # (G, kinds) measured over assumed standard deviation of the flow
    depth_scale: float        # the same of the inverse depths
    refined_uv_b: Array       # (N, 2) px: m + φ with the optimised flow of eq. (3)
    refined_rho_a: Array      # (N,) 1/m


@dataclass(frozen=True, slots=True)
class NoiseScales:
    """Measured over assumed standard deviations: where the next frame starts."""

    flow: Array               # (kinds,)
    depth: float = 1.0


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
    for _ in range(config.rounds):
        problem.renew(T)
        T, information = _levenberg_marquardt(problem, T, config)
        if adapt:
            problem.measure_noise(T)
    return problem.solution(T, information)


def _levenberg_marquardt(problem: _Problem, T: Array, config: MotionConfig) -> tuple[Array, Array]:
    """A few damped steps on all groups at once; a step that raises a group's cost is not taken."""
    damping = np.full(len(T), 1e-6)
    cost, H, g = problem.linearise(T)
    for _ in range(config.iterations):
        diagonal = np.einsum("gii->gi", H)
        damped = H + (damping[:, None] * diagonal + 1e-12)[:, :, None] * np.eye(6)
        step = -np.linalg.solve(damped, g[:, :, None])[:, :, 0]
        T_try = T @ se3.exp(step)
        cost_try, H_try, g_try = problem.linearise(T_try)
        better = cost_try <= cost
        T = np.where(better[:, None, None], T_try, T)
        H = np.where(better[:, None, None], H_try, H)
        g = np.where(better[:, None], g_try, g)
        cost = np.where(better, cost_try, cost)
        damping = np.where(better, damping * 0.1, np.minimum(damping * 100.0, 1e6))
        # The step's length in standard deviations says when there is nothing left to gain.
        if np.all(np.einsum("gi,gij,gj->g", step, H, step) < config.step_tolerance**2):
            break
    return T, H


class _Problem:
    """Both families, sorted by group."""

    def __init__(self, points: PointMatches, lines: LineMatches, groups: int, camera: Intrinsics,
                 config: MotionConfig, scales: NoiseScales) -> None:
        self.config, self.groups = config, groups
        self.point_order = np.argsort(points.group, kind="stable")
        self.line_order = np.argsort(lines.group, kind="stable")
        self.points = PointFamily(take(points, self.point_order), camera, config)
        self.lines = LineFamily(take(lines, self.line_order), camera, config)
        self.point_count = np.bincount(points.group, minlength=groups)
        self.line_count = np.bincount(lines.group, minlength=groups)
        self.flow_scale2 = np.repeat(np.asarray(scales.flow)[None] ** 2, groups, axis=0)
        self.depth_scale2 = scales.depth**2
        # Depth is good on a road and bad in a tree: its noise is measured tile by tile.
        self.point_tile = _tiles(self.points.m.uv_a, self.points.m.group, camera)
        self.line_tile = _tiles(self.lines.m.endpoints_a.mean(axis=1), self.lines.m.group, camera)
        self.tile_scale2 = np.full(_TILES[0] * _TILES[1] + groups, self.depth_scale2)
        self._spread_scales()

    def _spread_scales(self) -> None:
        m = self.points.m
        self.points.flow_scale2 = self.flow_scale2[m.group, m.kind]
        self.points.depth_scale2 = self.tile_scale2[self.point_tile]
        self.lines.depth_scale2 = self.tile_scale2[self.line_tile]

    def _per_feature(self, T: Array, count: Array) -> Array:
        """One pose a feature, laid out so that each of its elements is contiguous."""
        if self.groups == 1:
            return T[0]
        return np.repeat(T.transpose(1, 2, 0), count, axis=2).transpose(2, 0, 1)

    def renew(self, T: Array) -> None:
        """New covariances and eliminated depths at T."""
        self._spread_scales()
        if len(self.points.m):
            self.points.renew(self._per_feature(T, self.point_count))
        if len(self.lines.m):
            self.lines.renew(self._per_feature(T, self.line_count))

    def linearise(self, T: Array) -> tuple[Array, Array, Array]:
        """Robust cost (G,), normal matrices (G, 6, 6) and gradients (G, 6) at T."""
        cost, H, g = np.zeros(self.groups), np.zeros((self.groups, 6, 6)), np.zeros((self.groups, 6))
        for family, count in ((self.points, self.point_count), (self.lines, self.line_count)):
            if not len(family.m):
                continue
            r, J = family.whitened(self._per_feature(T, count))
            weight, loss = self._robust(np.einsum("nk,nk->n", r, r))
            root = np.sqrt(weight)
            r, J = r * root[:, None], J * root[:, None, None]
            stop = np.cumsum(count)
            for group, (first, last) in enumerate(zip(stop - count, stop, strict=True)):
                if first == last:
                    continue
                for row in range(r.shape[1]):
                    J_row = J[first:last, row]
                    H[group] += J_row.T @ J_row
                    g[group] += J_row.T @ r[first:last, row]
                cost[group] += loss[first:last].sum()
        return cost, H, g

    def _robust(self, chi2: Array) -> tuple[Array, Array]:
        """Weight and loss of squared whitened residuals; NaN counts as infinitely far."""
        chi2 = np.where(np.isfinite(chi2), chi2, 1e12)
        k = self.config.kernel_width
        if self.config.kernel == "huber":
            chi = np.sqrt(np.maximum(chi2, 1e-300))
            inside = chi <= k
            return np.where(inside, 1.0, k / chi), np.where(inside, chi2, 2.0 * k * chi - k * k)
        ratio = chi2 / (k * k)
        return 1.0 / (1.0 + ratio), k * k * np.log1p(ratio)

    def measure_noise(self, T: Array) -> None:
        """Scale the assumed noise to the residuals: flow by group and kind, depth by all."""
        f = self.points
        if not len(f.m):
            return
        r, _, j = f.marginal(self._per_feature(T, self.point_count))
        self._measure_depth_noise(r, j)
        depth_part = j[:, :2] ** 2 * (f.var_a * f.depth_scale2)[:, None]
        flow_part = np.stack([f.uu, f.vv], axis=1)
        square = r[:, :2] ** 2
        stop = np.cumsum(self.point_count)
        for group, last in enumerate(stop):
            first = last - self.point_count[group]
            for kind in range(self.flow_scale2.shape[1]):
                chosen = first + np.flatnonzero(f.m.kind[first:last] == kind)
                if len(chosen) < _MIN_FOR_SCALE:
                    # Too few to tell: the static world's flow has the same source.
                    self.flow_scale2[group, kind] = self.flow_scale2[0, kind]
                    continue
                self.flow_scale2[group, kind] = _excess_scale2(
                    square[chosen], flow_part[chosen], depth_part[chosen],
                    self.flow_scale2[group, kind])

    def _measure_depth_noise(self, r: Array, j: Array) -> None:
        """How far the eliminated depths moved, over what their noise allows: by tile and in all."""
        moved, allowed = self.points.depth_innovation(r, j)
        ratio = moved**2 / np.maximum(allowed, 1e-300)
        # A depth that neither parallax nor the second frame tests says nothing.
        tested = np.flatnonzero(allowed > _TESTED * self.points.var_a * self.points.depth_scale2)
        static = tested[self.points.m.group[tested] == 0]
        if len(static) < _MIN_FOR_SCALE:
            return
        before = self.points.depth_scale2
        square = ratio * before / _MEDIAN_CHI2_1
        self.depth_scale2 = max(float(np.median(square[static])), _SMALLEST_SCALE2)
        medians, count = _grouped_median(square[tested], self.point_tile[tested],
                                         len(self.tile_scale2))
        blended = (count * medians + _MIN_FOR_SCALE * self.depth_scale2) / (count + _MIN_FOR_SCALE)
        self.tile_scale2 = np.maximum(blended, _SMALLEST_SCALE2)

    def solution(self, T: Array, information: Array) -> Motions:
        T_points = self._per_feature(T, self.point_count)
        point_chi, uv, rho = np.zeros(0), np.zeros((0, 2)), np.zeros(0)
        line_chi = np.zeros(0)
        if len(self.points.m):
            point_chi = np.linalg.norm(self.points.whitened(T_points)[0], axis=1)
            uv, rho = self.points.refined_uv_b(T_points), self.points.rho
        if len(self.lines.m):
            line_chi = np.linalg.norm(
                self.lines.whitened(self._per_feature(T, self.line_count))[0], axis=1)
        back, line_back = np.argsort(self.point_order), np.argsort(self.line_order)
        return Motions(T, information, point_chi[back], line_chi[line_back],
                       np.sqrt(self.flow_scale2), float(np.sqrt(self.depth_scale2)),
                       uv[back], rho[back])


def _excess_scale2(square: Array, flow_part: Array, depth_part: Array, now2: float) -> float:
    """The flow scale s² for which the median of r² / (s² Σ_φ + depth part) is that of χ²₁."""
    ratio = float(np.median(square / (now2 * flow_part + depth_part))) / _MEDIAN_CHI2_1
    flow, depth = float(np.median(flow_part)), float(np.median(depth_part))
    scale2 = (ratio * (now2 * flow + depth) - depth) / flow
    return max(scale2, 0.01 * now2 * min(ratio, 1.0), _SMALLEST_SCALE2)


def _tiles(uv_px: Array, group: Array, camera: Intrinsics) -> Array:
    """Tile (N,) of each feature: by its place in the image, or by its object."""
    rows, columns = _TILES
    row = np.clip(uv_px[:, 1] * rows / camera.height, 0, rows - 1).astype(np.int64)
    column = np.clip(uv_px[:, 0] * columns / camera.width, 0, columns - 1).astype(np.int64)
    return np.where(group == 0, row * columns + column, rows * columns + group)


def _grouped_median(values: Array, group: Array, groups: int) -> tuple[Array, Array]:
    """Median (0 where empty) and count of values (N,) by group number."""
    order = np.lexsort((values, group))
    count = np.bincount(group, minlength=groups)
    first = np.cumsum(count) - count
    middle = np.minimum(first + count // 2, max(len(values) - 1, 0))
    return np.where(count > 0, values[order][middle], 0.0), count
