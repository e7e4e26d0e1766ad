"""The offset of a depth sensor's inverse depths, told by the steps from frame to frame.

The points of the map cannot tell it: those that fit it are those that agree with their depths. So
all points of a frame that have a depth are found in the next one, whatever they are in the map.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam.config import MotionConfig
from slam.dpl.config import DplConfig
from slam.dpl.features import KeyPoints
from slam.dpl.picture import Picture
from slam.dpl.track import TrackedFrame
from slam.estimation.calibration import DepthOffset, shifted_inverse
from slam.estimation.motion import NoiseScales, refine_motions
from slam.frontend.refine import RefineConfig, refine_matches
from slam.frontend.surface import carried, fit_surfaces
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import PointMatches, no_lines
from slam.tables import taken
from slam.types import Intrinsics

_LEAST = 50              # points found again, from which an offset is read
_TELLS = 1e-3            # 1/m: a pair of frames that knows it worse tells nothing,
_REST = 10               # and so many frames are left out then
_ENOUGH = 3e-5           # 1/m, standard deviation: a tenth of the least that is believed
_COMMON_PX = 0.35        # that patches of a pair may all err by along the flow (shading, filtered
                         # texture): an offset that moves points by less in a step is not told
                         # from that
_CHANGE = 2.0            # standard deviations by which what was learnt must differ from what is
                         # applied


class _Held(NamedTuple):
    """A frame whose points are sought in the next one."""

    picture: Picture
    points: KeyPoints
    T_world_camera: Array


class DepthCalibration:
    """What is known of the offset, and what of it has been applied."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config.depth
        self.learnt = DepthOffset()
        self.applied = 0.0               # 1/m, to all depths: of frames to come and of the map
        self._held: _Held | None = None
        self._rest = 0
        self._pairs, self._way_m = 0, 0.0          # that told it, and how far they were apart
        self._align, self._motion = RefineConfig(), MotionConfig()

    def learn(self, picture: Picture, tracked: TrackedFrame) -> None:
        """Learn from a frame and the one before it."""
        if not self.config.learn_depth_offset or self.learnt.sigma < _ENOUGH:
            return
        now = _Held(picture, tracked.features.points, tracked.T_world_camera)
        before, self._held = self._held, now
        self._rest -= 1
        if before is None or self._rest > 0:
            return
        offset, sigma = self._offset_between(before, now)
        if sigma < _TELLS:
            self.learnt = self.learnt.observed(offset, sigma)
            self.count_pair(float(np.linalg.norm(
                now.T_world_camera[:3, 3] - before.T_world_camera[:3, 3])))
        else:
            self._rest = _REST

    def count_pair(self, step_m: float) -> None:
        """One more pair of frames that told the offset, and how far they were apart."""
        self._pairs += 1
        self._way_m += step_m

    def forget_frame(self) -> None:
        """The next frame does not follow the last one, or that one's depths have changed."""
        self._held = None

    def due(self) -> float:
        """1/m, what is to be added to all depths so far; 0 where that would change little."""
        shift_px = abs(self.learnt.mean) * self.camera.fx * self._way_m / max(self._pairs, 1)
        if self.applied == 0.0 and shift_px < _COMMON_PX:
            return 0.0
        more = self.learnt.value - self.applied
        return more if abs(more) > _CHANGE * self.learnt.sigma else 0.0

    def apply(self, more: float) -> None:
        """This has been added to all depths of the map."""
        self.applied += more
        self.forget_frame()

    def _offset_between(self, before: _Held, now: _Held) -> tuple[float, float]:
        """The offset, 1/m, with its standard deviation; (0, inf) where it cannot be told.

        The likeliest one so far is where it is sought from.
        """
        more = self.learnt.mean - self.applied
        points, slope = self._with_depth(before)
        points = replace(points, rho_a=shifted_inverse(points.rho_a, more))
        T_a_b = se3.inverse(before.T_world_camera) @ now.T_world_camera
        found = self._found_again(points, slope, before.picture, T_a_b, now.picture)
        if len(found) < _LEAST:
            return 0.0, np.inf
        motions = refine_motions(T_a_b[None], found, no_lines(), self.camera, self._motion,
                                 NoiseScales(np.ones(1)))
        step, sigma = motions.depth_offset
        return self.learnt.mean + step, sigma

    def _with_depth(self, frame: _Held) -> tuple[PointMatches, Array]:
        """Points with depth, yet to be found, and the slopes (N, 2) of their surfaces.

        Their depths in the next frame are left out: a surface's depth errs there as it did here.
        """
        points = frame.points[np.flatnonzero(frame.points.depth_m > 0)]
        n, uv, sigma = len(points), points.uv_px, self.config.inverse_depth_sigma
        if frame.picture.depth_m.any():
            planes = fit_surfaces(frame.picture.rho, np.zeros(frame.picture.gray.shape, np.uint8),
                                  uv, sigma)
            rho, slope, sigmas = planes.rho, planes.slope, sigma * planes.gain
        else:
            assert points.whitening is not None      # of points of a pair
            rho, sigmas = 1.0 / points.depth_m, 1.0 / points.whitening[:, 3]
            slope = np.zeros((n, 2))
        known = np.flatnonzero(rho > 0)
        one = np.zeros(n, np.int64)
        return taken(PointMatches(uv, rho, sigmas, uv, np.tile(np.eye(2), (n, 1, 1)), np.zeros(n),
                                  np.full(n, np.inf), np.zeros((n, 2)), one, one),
                     known), slope[known]

    def _found_again(self, points: PointMatches, slope: Array, before: Picture, T_a_b: Array,
                     now: Picture) -> PointMatches:
        """Those of the points that the next picture shows, and where."""
        T_b_a = np.repeat(se3.inverse(T_a_b)[None], len(points), axis=0)
        uv, rho_b, warp = carried(self.camera, points.uv_a, points.rho_a, slope, T_b_a)
        behind = rho_b <= 0
        uv[behind], warp[behind] = -1.0, np.eye(2)
        surface = before.surface if before.depth_m.any() else None
        aligned = refine_matches(before.smooth, now.smooth, points.uv_a, uv, self._align, warp,
                                 surface)
        good = np.flatnonzero(aligned.converged)
        return replace(taken(points, good), uv_b=aligned.uv_current[good],
                       flow_cov=aligned.covariance[good])
