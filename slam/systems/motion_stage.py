"""From two observed frames to the motions between them: match, start, refine, align, refine."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from slam.config import MotionConfig, SdplConfig
from slam.dynamics.objects import ObjectTable
from slam.dynamics.scene_flow import moving
from slam.estimation.calibration import DepthOffset
from slam.estimation.covariance import sharing
from slam.estimation.motion import Motions, NoiseScales, refine_motions
from slam.estimation.start import start_motion
from slam.frontend.follow import (
    REFINED_KIND,
    align_points,
    align_segments,
    follow_points,
    follow_segments,
)
from slam.frontend.grid import GRID_KIND, OBJECT_GRID_KIND, grid_matches
from slam.frontend.observe import Observation
from slam.frontend.refine import RefineConfig as AlignConfig
from slam.frontend.refine import prepare_image
from slam.frontend.support import surface_image
from slam.frontend.surface import carried
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches, join, no_lines, take
from slam.systems.stopwatch import Stopwatch
from slam.types import FlowField, Frame, Intrinsics

if TYPE_CHECKING:
    from slam.systems.features import FeatureTracker

_KINDS = 4


@dataclass(frozen=True, slots=True)
class ObjectMotion:
    """One object between two frames, still in the previous camera."""

    label: int                 # in the current frame
    relative: Array            # (4, 4) its motion against the static world, in camera a
    information: Array         # (6, 6) of its pose T_a_b
    points_a: Array            # (N, 3) m, in camera a
    rigidity: float
    inliers: int
    sharing: float             # by how much the information is too bold: windows that overlap


@dataclass(frozen=True, slots=True)
class Tracked:
    """All motions between two frames, and the features that followed them."""

    T_a_b: Array                         # (4, 4) the camera's
    information: Array                   # (6, 6)
    objects: tuple[ObjectMotion, ...]
    left_out: tuple[tuple[int, str], ...]   # mask label now, why it has no motion
    point_index: Array                   # (P,) features of the previous frame that live on
    point_uv: Array                      # (P, 2)
    line_index: Array                    # (L,)
    line_endpoints: Array                # (L, 2, 2)
    inlier_points: int
    inlier_lines: int
    lost_because: str = ""
    sharing: float = 1.0                 # as ObjectMotion's, of the camera


@dataclass(frozen=True)
class _Matched:
    """Everything that goes into the solver, and which feature tracks it came from."""

    grid: PointMatches
    corners: PointMatches
    slopes: Array              # (N, 2) of the corners' inverse depth, 1/m/px
    corner_index: Array
    lines: LineMatches
    line_index: Array

    @cached_property
    def every(self) -> PointMatches:
        """The cells, then the corners."""
        return join(self.grid, self.corners)

    def points(self, parked: Array) -> PointMatches:
        """All points; those of parked groups count for the static world too."""
        if len(parked) == 0:
            return self.every
        still = take(self.every, np.isin(self.every.group, parked))
        return join(self.every, replace(still, group=np.zeros_like(still.group)))


class MotionStage:
    """Keeps what one frame teaches the next of the noise, and the images prepared for alignment."""

    def __init__(self, intrinsics: Intrinsics, config: SdplConfig) -> None:
        self.intrinsics, self.config = intrinsics, config
        self.scales = NoiseScales(np.ones(_KINDS))
        self.depth_offset = DepthOffset()
        self._noise_seen = False
        self._smooth: list[tuple[Frame, Array]] = []
        self._surfaces: list[tuple[Array, Array]] = []
        self._align = AlignConfig()

    def track(self, a: Observation, b: Observation, flow: FlowField, pairs: dict[int, int],
              features: FeatureTracker, T_a_b_expected: Array, objects: ObjectTable,
              T_world_a: Array, clock: Stopwatch) -> Tracked:
        """Motions from a to b.

        Args:
            pairs: mask label in b -> the same object's label in a.
            T_a_b_expected: (4, 4) camera motion expected.
        """
        a, b = a.shifted(self.depth_offset.value), b.shifted(self.depth_offset.value)
        labels_b = sorted(pairs)
        state = objects.of_label(a.frame.stamp_s)
        group_of_a = {pairs[label]: g for g, label in enumerate(labels_b, start=1)}
        parked = np.array([g for label, g in group_of_a.items()
                           if label in state and state[label].parked], dtype=np.int64)
        image_flow = flow is not b.frame.flow
        matched = self._match(a, b, flow, group_of_a,
                              b.groups({label: g for g, label in enumerate(labels_b, start=1)}),
                              features, image_flow)
        clock.lap("match")
        expected = [T_a_b_expected]
        dt_s = b.frame.stamp_s - a.frame.stamp_s
        for label in labels_b:
            known = state.get(pairs[label])
            relative = (np.eye(4) if known is None
                        else objects.predicted_relative(known.track, T_world_a, dt_s))
            expected.append(se3.inverse(relative) @ T_a_b_expected)
        starts, why = self._starts(matched, expected, parked)
        clock.lap("start")
        if 0 in why:
            return _lost(why[0])
        matched = _without(matched, np.array(sorted(why), dtype=np.int64))
        motions, matched, parked = self._solve(a, b, matched, starts, parked, image_flow, clock)
        if self.config.noise.learn_depth_offset:
            more, sigma = motions.depth_offset
            self.depth_offset = self.depth_offset.observed(self.depth_offset.value + more, sigma)
        return self._tracked(matched, motions, labels_b, why, parked, image_flow)

    def _match(self, a: Observation, b: Observation, flow: FlowField, group_of_a: dict[int, int],
               group_b: Array, features: FeatureTracker, image_flow: bool) -> _Matched:
        config = self.config
        noise = config.noise
        grid = grid_matches(flow, a.rho, b.rho, a.groups(group_of_a), group_b, config.grid, noise,
                            self.scales.depth if self._noise_seen else 0.0,
                            # Flow from the images errs alike over a cell: more rows add nothing.
                            static_rows=2 if image_flow else 1)
        if image_flow:
            grid = replace(grid, flow_cov=np.broadcast_to(
                np.eye(2) * config.refine.grid_sigma_px**2, (len(grid), 2, 2)))
        corners, slopes, corner_index = follow_points(
            features.points, _groups_of(features.points.instance_id, group_of_a), flow, a, b,
            group_b, noise)
        if not image_flow:
            # An object's cells hold all its depth already: counted again at its corners, it
            # would be believed twice, and weigh too much against the flow.
            corners = replace(corners, rho_sigma_b=np.where(corners.group > 0, np.inf,
                                                            corners.rho_sigma_b))
        lines, line_index = no_lines(), np.zeros(0, np.int64)
        if config.segments.enabled and len(features.segments):
            lines, line_index = follow_segments(
                features.segments, _groups_of(features.segments.instance_id, group_of_a), flow,
                a.label_index, group_b, noise)
            lines = replace(lines, rho_a=lines.rho_a + self.depth_offset.value)
        return _Matched(grid, corners, slopes, corner_index, lines, line_index)

    def _starts(self, matched: _Matched, expected: list[Array],
                parked: Array) -> tuple[Array, dict[int, str]]:
        """Where each group's refinement starts, and the groups that have too little to start."""
        points = matched.every
        why: dict[int, str] = {}
        starts = np.repeat(np.eye(4)[None], len(expected), axis=0)
        for group, T_expected in enumerate(expected):
            own = np.flatnonzero(points.group == group)
            needed = self.config.start.min_points if group == 0 else self.config.dynamic.min_matches
            if group == 0 and len(own) < needed:   # then what is parked is all there is
                own = np.flatnonzero(np.isin(points.group, [0, *parked]))
            if len(own) < needed:
                why[group] = f"{len(own)} matches, {needed} are needed"
                continue
            candidates = np.stack([T_expected, expected[0], np.eye(4)])
            found = start_motion(points, self.intrinsics, self.config.start,
                                 self.config.noise.flow_sigma_px, candidates, own)
            if found is None:
                why[group] = "no depth on it"
            else:
                starts[group] = found
        return starts, why

    def _solve(self, a: Observation, b: Observation, matched: _Matched, starts: Array,
               parked: Array, image_flow: bool, clock: Stopwatch
               ) -> tuple[Motions, _Matched, Array]:
        """The motions, the matches they rest on, and the parked groups that went on standing."""
        config = self.config
        align = self._aligns(image_flow)
        if align or len(parked):
            first = replace(config.motion, rounds=1)
            rough = self._refine(matched, starts, parked[:0], first, remember=False)
            parked = self._standing(matched, rough, parked, b.frame.stamp_s - a.frame.stamp_s)
            starts = rough.T_a_b
            clock.lap("motion")
            if align:
                matched = self._aligned(a, b, matched, rough, image_flow)
                clock.lap("align")
        motions = self._refine(matched, starts, parked, config.motion, remember=True)
        clock.lap("motion")
        return motions, matched, parked

    def _standing(self, matched: _Matched, rough: Motions, parked: Array, dt_s: float) -> Array:
        """The parked groups that go on standing, by motions that they had no share in.

        A thing that sets off would else pull the camera along, and then seem to stand.
        """
        every = matched.every
        moved = moving(rough.T_a_b[0] @ se3.inverse(rough.T_a_b[parked]), rough.information[0],
                       rough.information[parked],
                       [self._points_a(every, every.group == group) for group in parked],
                       max(dt_s, 1e-6), self.config.dynamic)
        return np.asarray(parked[moved == 0])

    def _points_a(self, matches: PointMatches, index: Array) -> Array:
        """(N, 3) m, in camera a."""
        return np.asarray(pinhole.back_project(self.intrinsics, matches.uv_a[index],
                                               1.0 / np.maximum(matches.rho_a[index], 1e-6)))

    def _aligns(self, image_flow: bool) -> bool:
        use = self.config.refine.use
        return use == "always" or (use == "auto" and image_flow)

    def _refine(self, matched: _Matched, starts: Array, parked: Array, config: MotionConfig,
                remember: bool) -> Motions:
        points = matched.points(parked)
        motions = refine_motions(starts, points, matched.lines, self.intrinsics, config,
                                 self.scales, self.config.noise.adapt)
        if remember and self.config.noise.adapt:
            present = np.bincount(points.kind, minlength=_KINDS) > 0
            measured = np.median(motions.flow_scale, axis=0)
            measured[GRID_KIND] = motions.flow_scale[0, GRID_KIND]
            keep = self.config.noise.memory if self._noise_seen else 0.0
            self._noise_seen = True
            self.scales = NoiseScales(
                np.where(present, keep * self.scales.flow + (1 - keep) * measured,
                         self.scales.flow),
                keep * self.scales.depth + (1 - keep) * motions.depth_scale)
        return motions

    def _aligned(self, a: Observation, b: Observation, matched: _Matched, rough: Motions,
                 image_flow: bool) -> _Matched:
        smooth_a, smooth_b = self.smoothed(a), self.smoothed(b)
        T_b_a = se3.inverse(rough.T_a_b)
        corners = matched.corners
        expected, warps = self._carried(corners.uv_a, corners.rho_a, matched.slopes,
                                        T_b_a[corners.group])
        # A rotation that is hardly known would deform the patches at random.
        belief = _belief_in_rotation(rough.information)[corners.group, None, None]
        warps = np.eye(2) + belief * (warps - np.eye(2))
        aligned, index = align_points(corners, expected, warps, smooth_a, smooth_b,
                                      self._surface(a), b, self.config.noise, self._align)
        lines, line_index = matched.lines, matched.line_index
        if len(lines):
            ends, _ = self._carried(lines.endpoints_a.reshape(-1, 2), lines.rho_a.reshape(-1),
                                    np.zeros((2 * len(lines), 2)),
                                    np.repeat(T_b_a[lines.group], 2, axis=0))
            lines, chosen = align_segments(lines, ends.reshape(-1, 2, 2), smooth_a, smooth_b)
            line_index = line_index[chosen]
        grid = matched.grid
        if image_flow:
            # Errors of estimated flow are alike over many cells: where aligned corners are
            # enough, cells would only pull.
            enough = np.bincount(aligned.group, minlength=len(T_b_a)) >= self.config.refine.enough
            grid = take(grid, ~enough[grid.group])
        return _Matched(grid, aligned, matched.slopes[index], matched.corner_index[index],
                        lines, line_index)

    def _carried(self, uv_a: Array, rho_a: Array, slopes: Array, T_b_a: Array
                 ) -> tuple[Array, Array]:
        """As `carried`, with NaN for what comes to lie behind the camera."""
        uv, rho_b, warps = carried(self.intrinsics, uv_a, rho_a, slopes, T_b_a)
        return np.where(rho_b[:, None] < 0, np.nan, uv), warps

    def smoothed(self, observation: Observation) -> Array:
        """The image prepared for alignment; the last two frames' are kept."""
        for frame, smooth in self._smooth:
            if frame is observation.frame:
                return smooth
        smooth = prepare_image(observation.gray, self._align)
        self._smooth = [*self._smooth[-1:], (observation.frame, smooth)]
        return smooth

    def prepare(self, current: Observation) -> None:
        """What aligning the frame after this one will need; may run beside `track`."""
        if self._aligns(current.frame.flow is None):
            image = surface_image(current.frame.depth_m, current.label_index)
            self._surfaces = [*self._surfaces[-1:], (current.label_index, image)]

    def _surface(self, observation: Observation) -> Array:
        for labels, image in self._surfaces:
            if labels is observation.label_index:
                return image
        return surface_image(observation.frame.depth_m, observation.label_index)

    def _tracked(self, matched: _Matched, motions: Motions, labels_b: list[int],
                 why: dict[int, str], parked: Array, image_flow: bool) -> Tracked:
        gate = self.config.motion.point_gate
        own = matched.every
        chi = motions.point_chi[: len(own)]
        good = chi < gate
        static = np.isin(own.group, [0, *parked])
        share = float(np.mean(good[static])) if static.any() else 0.0
        if share < self.config.start.min_inlier_share:
            return _lost(f"{share:.0%} of the static matches follow one motion")
        lines_good = np.flatnonzero(motions.line_chi < self.config.motion.line_gate)
        still_lines = int(np.count_nonzero(matched.lines.group[lines_good] == 0))
        if image_flow and self._aligns(image_flow):
            # Flow estimated on an image without texture is the prediction, handed back.
            corners_found = int(np.count_nonzero(static & good & (own.kind == REFINED_KIND)))
            if corners_found + 2 * still_lines < self.config.start.min_points:
                return _lost(f"{corners_found} corners and {still_lines} lines were found again")
        shared = np.ones(len(motions.T_a_b))
        if image_flow and self._aligns(image_flow):
            shared = sharing(matched.corners.uv_a, matched.corners.group, len(shared),
                             2.0 * self._align.radius_px + 1.0)
        objects = []
        for group, label in enumerate(labels_b, start=1):
            if group in why:
                continue
            members = own.group == group
            share = float(np.mean(good[members])) if members.any() else 0.0
            if share < self.config.dynamic.min_inlier_share:
                why[group] = f"{share:.0%} of its matches follow one motion"
                continue
            aligned = int(np.count_nonzero(members & good & (own.kind == REFINED_KIND)))
            needed = self.config.dynamic.min_matches
            if image_flow and self._aligns(image_flow) and aligned < needed:
                why[group] = f"{aligned} of its corners could be aligned"
                continue
            sigma = float(_rotation_sigma(motions.information[group]))
            if sigma > self.config.dynamic.max_rotation_sigma:
                why[group] = f"its rotation is known to {np.degrees(sigma):.1f}° only"
                continue
            objects.append(self._object(group, label, own, good, chi, motions,
                                        float(shared[group])))
        corners = slice(len(matched.grid), len(own))
        alive = np.flatnonzero(good[corners])
        return Tracked(
            motions.T_a_b[0], motions.information[0], tuple(objects),
            tuple((labels_b[g - 1], reason) for g, reason in sorted(why.items())),
            matched.corner_index[alive], motions.refined_uv_b[: len(own)][corners][alive],
            matched.line_index[lines_good], motions.refined_endpoints_b[lines_good],
            int(np.count_nonzero(good & static)), still_lines, sharing=float(shared[0]))

    def _object(self, group: int, label: int, own: PointMatches, good: Array, chi: Array,
                motions: Motions, shared: float) -> ObjectMotion:
        members = np.flatnonzero(own.group == group)
        points = self._points_a(own, members)
        # Against the static world's noise: an object that bends is not excused by its own.
        excess = motions.flow_scale[group, OBJECT_GRID_KIND] / self.scales.flow[OBJECT_GRID_KIND]
        rigid = chi[members] * max(1.0, float(excess)) < self.config.motion.point_gate
        return ObjectMotion(label, motions.T_a_b[0] @ se3.inverse(motions.T_a_b[group]),
                            motions.information[group], points[good[members]],
                            float(np.mean(rigid)), int(np.count_nonzero(good[members])), shared)


def _belief_in_rotation(information: Array) -> Array:
    """(G,) between 0 and 1: how small a rotation's uncertainty is against 0.02 rad."""
    return np.asarray(1.0 / (1.0 + (_rotation_sigma(information) / 0.02) ** 2))


def _rotation_sigma(information: Array) -> Array:
    """(...) rad: standard deviation of a rotation, over all axes, by information (..., 6, 6)."""
    variance = np.linalg.inv(information + np.eye(6) * 1e-6)
    return np.asarray(np.sqrt(np.trace(variance[..., :3, :3], axis1=-2, axis2=-1)))


def _groups_of(labels: Array, group_of_label: dict[int, int]) -> Array:
    """(N,) motion group of each feature by its mask label; −1 where it has none."""
    group = np.where(labels == 0, 0, -1)
    for label, g in group_of_label.items():
        group[labels == label] = g
    return group


def _without(matched: _Matched, groups: Array) -> _Matched:
    if len(groups) == 0:
        return matched
    corners = np.flatnonzero(~np.isin(matched.corners.group, groups))
    lines = np.flatnonzero(~np.isin(matched.lines.group, groups))
    return _Matched(take(matched.grid, ~np.isin(matched.grid.group, groups)),
                    take(matched.corners, corners), matched.slopes[corners],
                    matched.corner_index[corners],
                    take(matched.lines, lines), matched.line_index[lines])


def _lost(reason: str) -> Tracked:
    none = np.zeros(0, np.int64)
    return Tracked(np.eye(4), np.zeros((6, 6)), (), (), none, np.zeros((0, 2)), none,
                   np.zeros((0, 2, 2)), 0, 0, reason)
