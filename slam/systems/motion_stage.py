"""From two observed frames to the motions between them: match, start, refine, align, refine."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slam.config import MotionConfig, SdplConfig
from slam.dynamics.creep import STILL, Drift, added, creeps
from slam.dynamics.objects import ObjectTable
from slam.dynamics.scene_flow import BodySteps, CameraStep, moving
from slam.estimation.calibration import DepthOffset
from slam.estimation.covariance import rotation_sigma
from slam.estimation.depth_parts import common_depth_error
from slam.estimation.motion import Motions, NoiseScales, refine_motions
from slam.estimation.start import drawn_away, start_motion
from slam.frontend.follow import (
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
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import no_lines
from slam.systems.judgement import Solved, Tracked, followers_of, judged, lost
from slam.systems.matched import Matched
from slam.systems.stopwatch import Stopwatch
from slam.tables import taken
from slam.types import FlowField, Frame, Intrinsics

if TYPE_CHECKING:
    from slam.systems.features import FeatureTracker

_KINDS = 4


class Learnt(NamedTuple):
    """What each frame adds to: a frame that turns out lost adds nothing."""

    scales: NoiseScales
    drifts: dict[int, Drift]     # of the parked tracks


class MotionStage:
    """Keeps what one frame teaches the next of the noise, and the images prepared for alignment."""

    def __init__(self, intrinsics: Intrinsics, config: SdplConfig) -> None:
        self.intrinsics, self.config = intrinsics, config
        self.learnt = Learnt(NoiseScales(np.ones(_KINDS)), {})
        self.depth_offset = DepthOffset()
        self._noise_seen = False
        self._smooth: list[tuple[Frame, Array]] = []
        self._surfaces: list[tuple[Array, Array]] = []
        self._align = AlignConfig()

    @property
    def scales(self) -> NoiseScales:
        """Measured over stated noise, as the frames so far tell."""
        return self.learnt.scales

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
        parked_tracks = {g: state[label].track for label, g in group_of_a.items()
                         if label in state and state[label].parked}
        parked = np.array(list(parked_tracks), dtype=np.int64)
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
            return lost(why[0])
        matched = matched.without(np.array(sorted(why), dtype=np.int64))
        motions, matched, parked = self._solve(a, b, matched, starts, parked_tracks, T_world_a,
                                               image_flow, clock)
        if self.config.noise.learn_depth_offset:
            more, sigma = motions.depth_offset
            self.depth_offset = self.depth_offset.observed(self.depth_offset.value + more, sigma)
        on_images = image_flow and self._aligns(image_flow)
        solved = Solved(matched, motions, labels_b, parked, on_images,
                        2.0 * self._align.radius_px + 1.0, self.scales.clustering,
                        self.scales.common_depth, float(self.scales.flow[OBJECT_GRID_KIND]))
        return judged(solved, why, self.intrinsics, self.config)

    def _match(self, a: Observation, b: Observation, flow: FlowField, group_of_a: dict[int, int],
               group_b: Array, features: FeatureTracker, image_flow: bool) -> Matched:
        config = self.config
        noise = config.noise
        grid = grid_matches(flow, a.rho, b.rho, a.groups(group_of_a), group_b, config.grid, noise,
                            self.scales.depth if self._noise_seen else 0.0,
                            # Flow from the images errs alike over a cell: more rows add nothing.
                            static_rows=2 if image_flow else 1, noisy_pixels=not image_flow)
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
        return Matched(grid, corners, slopes, corner_index, lines, line_index)

    def _starts(self, matched: Matched, expected: list[Array],
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

    def _solve(self, a: Observation, b: Observation, matched: Matched, starts: Array,
               tracks: dict[int, int], T_world_a: Array, image_flow: bool, clock: Stopwatch
               ) -> tuple[Motions, Matched, Array]:
        """The motions, the matches they rest on, and the parked groups that went on standing.

        Args:
            tracks: parked group -> its track.
        """
        config = self.config
        align = self._aligns(image_flow)
        parked = none = np.zeros(0, np.int64)
        if align or tracks:
            first = replace(config.motion, rounds=1)
            rough = self._refine(matched, starts, none, first, remember=False)
            parked = self._standing(matched, rough, tracks, T_world_a,
                                    b.frame.stamp_s - a.frame.stamp_s)
            rough = self._not_drawn_away(matched, starts, rough)
            starts = rough.T_a_b
            clock.lap("motion")
            if align:
                matched = self._aligned(a, b, matched, rough, image_flow)
                clock.lap("align")
        motions = self._refine(matched, starts, parked, config.motion, remember=True)
        clock.lap("motion")
        return motions, matched, parked

    def _not_drawn_away(self, matched: Matched, starts: Array, rough: Motions) -> Motions:
        """The first motions, with the starts of those groups that they fit less finely.

        Flow from the images is trusted to a pixel: where much moves otherwise, that is wide enough
        for a good start to be left for a pose between the two.
        """
        points, config = matched.every, self.config
        back = [drawn_away(start, refined, points, self.intrinsics, config.start,
                           config.noise.flow_sigma_px, np.flatnonzero(points.group == group))
                for group, (start, refined) in enumerate(zip(starts, rough.T_a_b, strict=True))]
        return replace(rough, T_a_b=np.where(np.array(back)[:, None, None], starts, rough.T_a_b))

    def _standing(self, matched: Matched, rough: Motions, tracks: dict[int, int],
                  T_world_a: Array, dt_s: float) -> Array:
        """The parked groups that go on standing, by motions that they had no share in.

        A thing that sets off would else pull the camera along, and then seem to stand. Slow things
        count as static, but no part of the world: the test is that of what moved before, and one
        of all that they have moved since.
        """
        parked, every = np.array(list(tracks), dtype=np.int64), matched.every
        static, information = rough.T_a_b[0], rough.information / max(rough.clustering, 1.0)
        camera = CameraStep(static, information[0], max(dt_s, 1e-6), self.scales.common_depth)
        bodies = BodySteps(static @ se3.inverse(rough.T_a_b[parked]), information[parked],
                           [followers_of(self.intrinsics, every, every.group == group)
                            for group in parked], np.ones(len(parked), np.bool_))
        drifts = added([self.learnt.drifts.get(track, STILL) for track in tracks.values()], camera,
                       bodies, T_world_a)
        self.learnt = self.learnt._replace(drifts=dict(zip(tracks.values(), drifts, strict=True)))
        moved = moving(camera, bodies, self.config.dynamic)
        stays = np.array([not creeps(drift) for drift in drifts], np.bool_)
        return np.asarray(parked[(moved <= 0) & stays])

    def _aligns(self, image_flow: bool) -> bool:
        use = self.config.refine.use
        return use == "always" or (use == "auto" and image_flow)

    def _refine(self, matched: Matched, starts: Array, parked: Array, config: MotionConfig,
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
            common = common_depth_error(points, motions.T_a_b[0], self.intrinsics)
            self.learnt = self.learnt._replace(scales=NoiseScales(
                np.where(present, keep * self.scales.flow + (1 - keep) * measured,
                         self.scales.flow),
                keep * self.scales.lines + (1 - keep) * motions.line_scale,
                keep * self.scales.depth + (1 - keep) * motions.depth_scale,
                keep * self.scales.clustering + (1 - keep) * motions.clustering,
                self.scales.common_depth if np.isnan(common)
                else keep * self.scales.common_depth + (1 - keep) * common))
        return motions

    def _aligned(self, a: Observation, b: Observation, matched: Matched, rough: Motions,
                 image_flow: bool) -> Matched:
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
            grid = taken(grid, ~enough[grid.group])
        return Matched(grid, aligned, matched.slopes[index], matched.corner_index[index],
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


def _belief_in_rotation(information: Array) -> Array:
    """(G,) between 0 and 1: how small a rotation's uncertainty is against 0.02 rad."""
    return np.asarray(1.0 / (1.0 + (rotation_sigma(information) / 0.02) ** 2))


def _groups_of(labels: Array, group_of_label: dict[int, int]) -> Array:
    """(N,) motion group of each feature by its mask label; −1 where it has none."""
    group = np.where(labels == 0, 0, -1)
    for label, g in group_of_label.items():
        group[labels == label] = g
    return group
