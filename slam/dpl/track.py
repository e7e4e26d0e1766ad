"""A frame's pose: first against the frame before, then against the local map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.culling import inside_boxes
from slam.dpl.features import Features
from slam.dpl.keyframes import PointLineMap
from slam.dpl.matching import as_words, match_lines_near, match_near
from slam.dpl.pose import refine_pose
from slam.dpl.sightings import joined, of_line_ends, of_points
from slam.dpl.view import lines_in_view, points_in_view
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project, project
from slam.types import Intrinsics


@dataclass(slots=True)
class TrackedFrame:
    """A frame with its pose, and the landmarks its features are."""

    features: Features
    T_world_camera: Array
    point_of: Array          # (N,) int64 row of the map point, −1: none
    line_of: Array           # (L,) the same of map lines

    @property
    def held(self) -> int:
        """Landmarks that are seen in it."""
        return int(np.count_nonzero(self.point_of >= 0) + np.count_nonzero(self.line_of >= 0))


@dataclass(frozen=True, slots=True)
class Pairs:
    """Landmarks (positions in the world) and the features that they were seen as."""

    xyz: Array               # (P, 3)
    point: Array             # (P,) rows of the frame's points
    ends: Array              # (Q, 2, 3)
    line: Array              # (Q,) rows of the frame's lines

    def only(self, points: Array, lines: Array) -> Pairs:
        """Those of the points (P,) bool and of the lines (Q,) bool."""
        return Pairs(self.xyz[points], self.point[points], self.ends[lines], self.line[lines])


@dataclass(frozen=True, slots=True)
class Seen:
    """Pairs with landmarks of the map, and which landmarks were looked for."""

    pairs: Pairs
    points: Array            # (P,) landmarks' rows of the pairs
    lines: Array             # (Q,)
    points_in_view: Array    # rows that the pose should see
    lines_in_view: Array


@dataclass(frozen=True, slots=True)
class Fit:
    T_world_camera: Array
    point_fits: Array        # (P,) bool
    line_fits: Array         # (Q,) bool
    information: Array       # (6, 6)
    asked: int               # pairs that had a say

    @property
    def inliers(self) -> int:
        return int(np.count_nonzero(self.point_fits) + np.count_nonzero(self.line_fits))

    @property
    def share(self) -> float:
        """How many of the pairs asked fit."""
        return self.inliers / max(self.asked, 1)


class PoseTracker:
    """Matches and fits; holds no state but settings."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config

    def fit(self, T_world_camera: Array, pairs: Pairs, features: Features,
            covariance: Array | None = None, iterations: int | None = None) -> Fit:
        """The pose that pairs support; the feet of line ends are renewed once.

        Args:
            iterations: at most; None: as the settings say; 0: what fits the pose given.
            covariance: (P + 2 Q, 3, 3) m² of the points and then of the lines' ends.
        """
        c = self.config.track
        points, lines = features.points[pairs.point], features.lines[pairs.line]
        sigma_rho = self.config.depth.inverse_depth_sigma
        seen_points = of_points(points, c.point_sigma_px, self.config.orb.scale, sigma_rho)
        xyz = np.concatenate([pairs.xyz, pairs.ends.reshape(-1, 3)])
        T = T_world_camera
        for _ in range(2 if len(pairs.line) else 1):
            seen = joined(seen_points, of_line_ends(pairs.ends, lines, T, self.camera,
                                                    c.line_sigma_px, sigma_rho))
            found = refine_pose(T, xyz, seen, self.camera, c.kernel_width,
                                c.iterations if iterations is None else iterations, covariance)
            T = found.T_world_camera
        fits = np.asarray(found.chi2 < c.gate**2)
        P = len(pairs.point)
        return Fit(T, fits[:P], np.asarray(fits[P:].reshape(-1, 2).all(axis=1)), found.information,
                   P + len(pairs.line))

    def fit_beside(self, boxes: Array, T_world_camera: Array, pairs: Pairs, features: Features
                   ) -> Fit:
        """As `fit`, but what lies in boxes (B, 4) has no say in which pose it is held against.

        It joins where it fits the pose of what lies outside, if that is enough to tell one: a
        mover rich in corners would else outvote the world around it.
        """
        c = self.config.track
        points = np.asarray(~inside_boxes(features.points.uv_px[pairs.point], boxes).any(axis=0))
        middle_px = features.lines.ends_px[pairs.line].mean(axis=1)
        lines = np.asarray(~inside_boxes(middle_px, boxes).any(axis=0))
        if points.all() and lines.all():
            return self.fit(T_world_camera, pairs, features)
        outside = self.fit(T_world_camera, pairs.only(points, lines), features)
        if outside.inliers < 2 * c.min_inliers or outside.share < c.min_inlier_share:
            return self.fit(T_world_camera, pairs, features)
        joining = self.fit(outside.T_world_camera, pairs, features, iterations=0)
        points, lines = points | joining.point_fits, lines | joining.line_fits
        whole = self.fit(outside.T_world_camera, pairs.only(points, lines), features)
        points[points], lines[lines] = whole.point_fits, whole.line_fits
        return Fit(whole.T_world_camera, points, lines, whole.information, whole.asked)

    def against_frame(self, before: TrackedFrame, features: Features, T_expected: Array,
                      map_: PointLineMap, radius_px: float) -> tuple[Pairs, Array, Array]:
        """Pairs with the frame before, whose features know their depth or are landmarks.

        Returns:
            pairs; of each pair's point (P,) and line (Q,) the landmark's row, −1: none.
        """
        c = self.config.track
        old, T_camera_world = before.features, se3.inverse(T_expected)
        xyz = se3.transform_points(before.T_world_camera, back_project(
            self.camera, old.points.uv_px, old.points.depth_m))
        mapped = before.point_of >= 0
        xyz[mapped] = map_.points.xyz[before.point_of[mapped], 0]
        known = mapped | (old.points.depth_m > 0)
        uv = project(self.camera, se3.transform_points(T_camera_world, xyz))
        uv[~known] = np.nan
        radius = radius_px * (1.0 + 0.2 * old.points.level)
        new = features.points
        match = match_near(uv, as_words(old.points.descriptor), radius, old.points.level,
                           new.uv_px, as_words(new.descriptor), new.level,
                           c.descriptor_distance, 0.9)
        p = np.flatnonzero(match >= 0)
        ends, line_match = self._lines_of_frame(before, features, T_camera_world, map_, radius_px)
        q = np.flatnonzero(line_match >= 0)
        return (Pairs(xyz[p], match[p], ends[q], line_match[q]), before.point_of[p],
                before.line_of[q])

    def _lines_of_frame(self, before: TrackedFrame, features: Features, T_camera_world: Array,
                        map_: PointLineMap, radius_px: float) -> tuple[Array, Array]:
        old = before.features.lines
        ends = se3.transform_points(before.T_world_camera, back_project(
            self.camera, old.ends_px, old.depth_m).reshape(-1, 3)).reshape(-1, 2, 3)
        mapped = before.line_of >= 0
        ends[mapped] = map_.lines.xyz[before.line_of[mapped]]
        known = mapped | (old.depth_m > 0).all(axis=1)
        uv = project(self.camera, se3.transform_points(
            T_camera_world, ends.reshape(-1, 3))).reshape(-1, 2, 2)
        uv[~known] = np.nan
        return ends, match_lines_near(uv, as_words(old.descriptor), features.lines.ends_px,
                                      as_words(features.lines.descriptor), radius_px,
                                      self.config.track.line_distance)

    def look_for(self, map_: PointLineMap, point_rows: Array, line_rows: Array,
                 features: Features, T_world_camera: Array, radius_px: float) -> Seen:
        """Pairs with landmarks that the pose should see; the map stays as it is."""
        c, orb = self.config.track, self.config.orb
        new = features.points
        view = points_in_view(map_.points, point_rows, T_world_camera, self.camera, orb.scale,
                              orb.levels)
        match = match_near(view.uv_px, map_.points.words[view.rows],
                           radius_px * orb.scale ** view.level.astype(np.float64), view.level,
                           new.uv_px, as_words(new.descriptor), new.level, c.map_distance,
                           c.ratio)
        p = np.flatnonzero(match >= 0)
        lines = lines_in_view(map_.lines, line_rows, T_world_camera, self.camera)
        line_match = match_lines_near(lines.ends_px, map_.lines.words[lines.rows],
                                      features.lines.ends_px,
                                      as_words(features.lines.descriptor), 2.0 * radius_px,
                                      c.line_distance)
        q = np.flatnonzero(line_match >= 0)
        p_rows, q_rows = view.rows[p], lines.rows[q]
        return Seen(Pairs(map_.points.xyz[p_rows, 0], match[p], map_.lines.xyz[q_rows],
                          line_match[q]), p_rows, q_rows, view.rows, lines.rows)
