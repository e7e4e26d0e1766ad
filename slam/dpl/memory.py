"""What is remembered of landmarks beside their place: how they looked, how well they are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.dpl.anchors import Anchors, pinned, reweighed, sharpened
from slam.dpl.borders import depth_off_borders
from slam.dpl.certainty import Certainty
from slam.dpl.config import DplConfig
from slam.dpl.culling import StillGround
from slam.dpl.features import Features, KeyPoints, joined
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.landmarks import Landmarks
from slam.dpl.picture import Picture
from slam.dpl.seek import to_seek
from slam.dpl.sightings import of_line_ends, of_points
from slam.dpl.track import Pairs, Seen
from slam.dpl.view import whole_level
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import project
from slam.types import Intrinsics


class LandmarkMemory:
    """Learns from keyframes, and makes the sightings of later frames precise."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config
        self.anchors = Anchors(camera, config.anchors, config.depth.inverse_depth_sigma)
        self._points, self._ends = Certainty(), Certainty()

    def learn(self, map_: PointLineMap, keyframe: Keyframe, picture: Picture) -> None:
        """Remember the landmarks of a keyframe that was just made of this picture."""
        self._forget_former(map_, keyframe.number)
        held = np.flatnonzero(keyframe.point_of >= 0)
        rows, points = keyframe.point_of[held], keyframe.features.points[held]
        depth = points.depth_m
        c, T = self.config, keyframe.T_world_camera
        cut = self.anchors.cut(rows, points.uv_px, np.where(
            depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0), picture, keyframe.number)
        if c.anchors.enabled:
            points = pinned(points, np.flatnonzero(cut), c.anchors.own_sigma_px)
            keyframe.features = Features(
                pinned(keyframe.features.points, held[cut], c.anchors.own_sigma_px),
                keyframe.features.lines)
        rho_sigma, width = c.depth.inverse_depth_sigma, c.track.kernel_width
        self._points.add(rows, map_.points.xyz[rows, 0], of_points(
            points, c.track.point_sigma_px, c.orb.scale, rho_sigma), T, self.camera, width)
        held = np.flatnonzero(keyframe.line_of >= 0)
        rows = keyframe.line_of[held]
        ends = map_.lines.xyz[rows]
        self._ends.add(_rows_of_ends(rows), ends.reshape(-1, 3), of_line_ends(
            ends, keyframe.features.lines[held], T, self.camera, c.track.line_sigma_px, rho_sigma),
            T, self.camera, width)

    def _forget_former(self, map_: PointLineMap, number: int) -> None:
        """Rows of the landmarks that a keyframe made may have been others' before."""
        new = np.flatnonzero(map_.points.born == number)
        self.anchors.forget(new)
        self._points.forget(new)
        self._ends.forget(_rows_of_ends(np.flatnonzero(map_.lines.born == number)))

    def covariance(self, seen: Seen, T_world_camera: Array) -> Array:
        """(P + 2 Q, 3, 3) m² of the points and the lines' ends that were seen."""
        pairs = seen.pairs
        centre = T_world_camera[:3, 3]
        far_points = np.linalg.norm(pairs.xyz - centre, axis=1)
        far_ends = np.linalg.norm(pairs.ends.reshape(-1, 3) - centre, axis=1)
        return np.concatenate([self._points.covariance(seen.points, far_points),
                               self._ends.covariance(_rows_of_ends(seen.lines), far_ends)])

    def sharpen(self, map_: PointLineMap, features: Features, seen: Seen, fits: Array,
                T_world_camera: Array, picture: Picture, ground: StillGround | None
                ) -> tuple[Features, Seen]:
        """Find landmarks by their patches: those that points fit (P,), and the others in view.

        The points are moved there; of the other landmarks, those found become points of the
        frame. Pairs of points that do not fit are dropped.

        Args:
            ground: where nothing moves; None: everywhere.
        """
        c, at = self.config, np.flatnonzero(fits)
        uv = project(self.camera, se3.transform_points(se3.inverse(T_world_camera),
                                                       seen.pairs.xyz[at]))
        sought = to_seek(map_.points, np.setdiff1d(seen.points_in_view, seen.points[at]), uv,
                         T_world_camera, self.camera, picture, ground,
                         c.depth.inverse_depth_sigma, c.anchors.apart_px)
        rows = np.concatenate([seen.points[at], sought.rows])
        aligned = self.anchors.align(rows, map_.poses_of, T_world_camera,
                                     np.concatenate([uv, sought.uv_px]), picture)
        new = len(at) + np.flatnonzero(aligned.converged[len(at):])
        points = joined(features.points, self._as_points(map_.points, rows[new],
                                                         aligned.uv_current[new], T_world_camera,
                                                         picture))
        which = np.full(len(rows), -1)
        which[:len(at)] = seen.pairs.point[at]
        which[new] = len(features.points) + np.arange(len(new))
        found = np.concatenate([np.arange(len(at)), new])
        pairs = replace(seen.pairs, xyz=map_.points.xyz[rows[found], 0], point=which[found])
        return (Features(sharpened(points, which, aligned, c.anchors.sigma_px), features.lines),
                replace(seen, pairs=pairs, points=rows[found]))

    def _as_points(self, points: Landmarks, rows: Array, uv_px: Array, T_world_camera: Array,
                   picture: Picture) -> KeyPoints:
        """Landmarks found at pixels (N, 2) as points of the frame, which look as they did."""
        distance = np.linalg.norm(points.xyz[rows, 0] - T_world_camera[:3, 3], axis=1)
        orb = self.config.orb
        level = whole_level(points.level_at(rows, distance, orb.scale), orb.levels)
        depth = depth_off_borders(picture.depth_m, uv_px, orb.scale ** level.astype(np.float64),
                                  self.config.depth.inverse_depth_sigma)
        return KeyPoints(uv_px, level, np.zeros(len(rows)),
                         points.words[rows].view(np.uint8).reshape(-1, 32), depth)

    def weigh(self, features: Features, pairs: Pairs, fits: Array, T_world_camera: Array
              ) -> Features:
        """Features of which the points that fit (P,) a pose and are aligned weigh by how well."""
        points, c = features.points, self.config.anchors
        assert points.whitening is not None      # of features from `sharpen`
        at = np.flatnonzero(fits & (points.whitening[pairs.point, 0] > 0))
        seen = project(self.camera, se3.transform_points(se3.inverse(T_world_camera),
                                                         pairs.xyz[at]))
        which = pairs.point[at]
        return Features(reweighed(points, which, seen - points.uv_px[which], c.sigma_px,
                                  c.least_sigma_px), features.lines)


def _rows_of_ends(rows: Array) -> Array:
    """(2 N,) of the two ends of each line."""
    return np.asarray((2 * rows[:, None] + [0, 1]).reshape(-1))
