"""Map points seen to a fraction of a pixel: aligned with the patch around their first sighting.

A corner's own position is a whole pixel of its pyramid level. What a landmark is, is fixed by the
picture in which it was first seen; in each later picture its patch is found there again, bent as
the two poses and the landmark's surface bend it. As all sightings lean on one patch, their errors
do not add up from frame to frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slam.dpl.config import AnchorConfig
from slam.dpl.features import KeyPoints
from slam.dpl.picture import Picture
from slam.dpl.sightings import covariance_of, whitening_of
from slam.estimation.calibration import shifted_inverse
from slam.frontend.patches import fits
from slam.frontend.refine import RefineConfig, RefinedMatches, refine_matches
from slam.frontend.surface import carried, fit_surfaces
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.spread import sigma_of_distances
from slam.types import Intrinsics


class Anchors:
    """The patches, by row of the map's points."""

    def __init__(self, camera: Intrinsics, config: AnchorConfig, inverse_depth_sigma: float
                 ) -> None:
        self.camera, self.config, self.sigma = camera, config, inverse_depth_sigma
        self.alignment = RefineConfig(
            radius_px=config.radius_px, prior_sigma_px=config.prior_sigma_px,
            max_move_px=config.max_move_px, min_correlation=config.min_correlation)
        self._side = 2 * config.radius_px + 4        # with what the interpolation reaches for
        self._grow_to(1024)
        self.known = np.zeros(len(self._uv), bool)

    def _grow_to(self, size: int) -> None:
        held = dict(vars(self))
        self._tile = np.zeros((size, self._side, self._side), np.float32)
        self._surface = np.zeros((size, self._side, self._side), np.float32)
        self._uv = np.zeros((size, 2))
        self._rho = np.zeros(size)
        self._slope = np.zeros((size, 2))
        self._keyframe = np.zeros(size, np.int64)
        self.known = np.zeros(size, bool)
        for name in ("_tile", "_surface", "_uv", "_rho", "_slope", "_keyframe", "known"):
            if name in held:
                getattr(self, name)[:len(held[name])] = held[name]

    def cut(self, rows: Array, uv_px: Array, rho: Array, picture: Picture, keyframe: int) -> Array:
        """Keep the patches around landmarks' pixels (N, 2), of inverse depths (N,), in a keyframe.

        Landmarks that have a patch, or whose patch would leave the picture, are left as they are.

        Returns:
            (N,) bool: whose patch was cut.
        """
        if len(rows) and rows.max() >= len(self.known):
            self._grow_to(max(2 * len(self.known), int(rows.max()) + 1))
        new = ~self.known[rows] & (rho > 0) & fits(uv_px, picture.gray.shape, self.config.radius_px)
        rows, uv, rho = rows[new], uv_px[new], rho[new]
        corner = np.floor(uv).astype(np.int64) - self.config.radius_px - 1
        down = corner[:, 1, None, None] + np.arange(self._side)[None, :, None]
        right = corner[:, 0, None, None] + np.arange(self._side)[None, None, :]
        self._tile[rows] = picture.smooth[down, right]
        self._surface[rows] = picture.surface[down, right]
        self._uv[rows], self._rho[rows], self._keyframe[rows] = uv, rho, keyframe
        planes = fit_surfaces(picture.rho, np.zeros(picture.gray.shape, np.uint8), uv, self.sigma)
        self._slope[rows] = np.where((planes.rho > 0)[:, None], planes.slope, 0.0)
        self.known[rows] = True
        return np.asarray(new)

    def shift(self, offset: float) -> None:
        """Add an offset, 1/m, to the inverse depths of all."""
        self._rho[self.known] = shifted_inverse(self._rho[self.known], offset)

    def forget(self, rows: Array) -> None:
        """Rows that are other landmarks' now: these have no patch yet."""
        self.known[rows[rows < len(self.known)]] = False

    def align(self, rows: Array, poses_of: Callable[[Array], Array], T_world_camera: Array,
              uv_start: Array, picture: Picture) -> RefinedMatches:
        """Where in a picture landmarks are, to be found around `uv_start` (N, 2).

        Args:
            poses_of: T_world_camera (N, 4, 4) of keyframes by their numbers (N,).
        """
        known = self.known[np.minimum(rows, len(self.known) - 1)] & (rows < len(self.known))
        rows = np.where(known, rows, 0)
        T_b_a = se3.inverse(T_world_camera) @ poses_of(self._keyframe[rows])
        _, rho_b, A = carried(self.camera, self._uv[rows], self._rho[rows], self._slope[rows],
                              T_b_a)
        known &= rho_b > 0                                    # before the camera
        A[~known] = np.eye(2)
        side = self._side
        at = self._uv[rows] - np.floor(self._uv[rows]) + self.config.radius_px + 1
        at[:, 1] += side * np.arange(len(rows))
        start = np.where(known[:, None], uv_start, -1.0)      # what does not fit is not aligned
        return refine_matches(self._tile[rows].reshape(-1, side), picture.smooth, at, start,
                              self.alignment, A, self._surface[rows].reshape(-1, side))


def pinned(points: KeyPoints, which: Array, sigma_px: float) -> KeyPoints:
    """Points of which some, `which` (M,), are where their landmarks' patches were cut.

    What such a landmark is, is defined by this pixel: as far as it errs, all later sightings err
    alike.
    """
    whitening = points.known_better()
    whitening[which, :3] = np.array([1.0, 0.0, 1.0]) / sigma_px
    return replace(points, whitening=whitening)


def reweighed(points: KeyPoints, which: Array, residual_px: Array, assumed_px: float,
              least_px: float) -> KeyPoints:
    """Points of which some, `which` (M,), were aligned, weighed by the noise that they show.

    What alignments err by beside what their patches tell (blur, a rolling shutter, surfaces that
    are not flat) differs from camera to camera and from frame to frame: it is what the residuals
    spread by beyond the patches' own covariances.

    Args:
        residual_px: (M, 2) of the points against the pose that they support.
        assumed_px: what `sharpened` took that noise for.
    """
    if not len(which):
        return points
    assert points.whitening is not None
    own = covariance_of(points.whitening[which]) - assumed_px**2 * np.eye(2)
    spread = sigma_of_distances(residual_px)
    own_variance = float(np.median(0.5 * (own[:, 0, 0] + own[:, 1, 1])))
    sigma = max(np.sqrt(max(spread**2 - own_variance, 0.0)), least_px)
    whitening = points.whitening.copy()
    whitening[which, :3] = whitening_of(own + sigma**2 * np.eye(2))
    return replace(points, whitening=whitening)


def sharpened(points: KeyPoints, which: Array, aligned: RefinedMatches, sigma_px: float
              ) -> KeyPoints:
    """Points of which some, `which` (M,), are where their patches were aligned."""
    good = aligned.converged
    at = which[good]
    uv = points.uv_px.copy()
    whitening = points.known_better()
    uv[at] = aligned.uv_current[good]
    whitening[at, :3] = whitening_of(aligned.covariance[good] + sigma_px**2 * np.eye(2))
    return replace(points, uv_px=uv, whitening=whitening)
