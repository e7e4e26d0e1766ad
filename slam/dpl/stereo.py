"""Depth of points and lines by matching a rectified pair (III-A.1), and pairs that are none."""

from __future__ import annotations

import logging
from dataclasses import replace

import numba
import numpy as np

from slam.dpl.config import StereoConfig
from slam.dpl.features import Features, KeyLines, KeyPoints
from slam.dpl.matching import as_words, hamming, match_all
from slam.dpl.stereo_lines import line_disparities, match_line_pairs
from slam.frontend.refine import RefineConfig, refine_matches
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_log = logging.getLogger(__name__)

_RELIEF = 2.1            # what disparities err by over what flat patches would, in the median
_SUSPICIOUS_SHARE = 0.2  # of points with a partner; with fewer a pair is looked into
_ENOUGH = 30             # matches that tell whether a pair is one
_SWAPPED_SHARE = 0.6     # of them with negative disparity


class StereoMatcher:
    """Gives features depth from a right picture, and says once what is wrong with a pair."""

    def __init__(self, camera: Intrinsics, config: StereoConfig, scale: float) -> None:
        """
        Args:
            scale: of the pyramid of points.
        """
        self.camera, self.config, self.scale = camera, config, scale
        self._checked = False
        self.fault = ""                  # of the last pair

    def __call__(self, left: Features, right: Features, smooth_left: Array, smooth_right: Array
                 ) -> Features:
        """The left features with depth; without any where the two are no pair."""
        found = with_stereo_depth(left, right, smooth_left, smooth_right, self.camera, self.config,
                                  self.scale)
        share = np.count_nonzero(found.points.depth_m) / max(len(left.points), 1)
        self.fault = ""
        if not self._checked or share < _SUSPICIOUS_SHARE:
            self.fault = fault_of_pair(left.points, right.points, self.config)
            if self.fault and not self._checked:
                _log.warning("%s", self.fault)
            self._checked = self._checked or len(left.points) >= _ENOUGH
        return left if self.fault else found


def with_stereo_depth(left: Features, right: Features, smooth_left: Array, smooth_right: Array,
                      camera: Intrinsics, config: StereoConfig, scale: float) -> Features:
    """The left features with the depth that their partners in the right picture give them.

    Args:
        smooth_left, smooth_right: (H, W) float32 from `refine.prepare_image`.
        scale: of the pyramid of points.
    """
    assert camera.baseline_m is not None
    K = camera.fx * camera.baseline_m                            # D = K / D_v
    match = match_rows(left.points, right.points, config, scale)
    disparity, sigma = _aligned(left.points, right.points, match, smooth_left, smooth_right,
                                config)
    depth = np.where(disparity > 0, K / np.where(disparity > 0, disparity, 1.0), 0.0)
    whitening = np.zeros((len(left.points), 4))
    whitening[:, 3] = np.where(disparity > 0, K / np.hypot(_RELIEF * sigma, config.sigma_px), 0.0)
    return Features(replace(left.points, depth_m=depth, whitening=whitening),
                    _lines_with_depth(left.lines, right.lines, K, config,
                                      smooth_left.shape))


def match_rows(left: KeyPoints, right: KeyPoints, config: StereoConfig, scale: float) -> Array:
    """(N,) for each left point its partner's row in the right ones, or −1; nearest both ways."""
    match = np.full(len(left), -1, np.int64)
    if not len(left) or not len(right):
        return match
    order = np.argsort(right.uv_px[:, 1], kind="stable")
    reach = config.row_px * scale ** left.level.astype(np.float64)
    low = np.searchsorted(right.uv_px[order, 1], left.uv_px[:, 1] - reach)
    high = np.searchsorted(right.uv_px[order, 1], left.uv_px[:, 1] + reach, side="right")
    _match_rows(left.uv_px, left.level, as_words(left.descriptor), right.uv_px, right.level,
                as_words(right.descriptor), order, low, high, config.min_disparity_px,
                config.max_disparity_px, config.descriptor_distance, match)
    return match


@numba.njit(cache=True)
def _match_rows(uv, level, words, uv_right, level_right, words_right,  # type: ignore[no-untyped-def]
                order, low, high, least, most, max_distance, match):
    owner = np.full(len(uv_right), -1, np.int64)
    owned = np.full(len(uv_right), max_distance + 1, np.int64)
    for i in range(len(uv)):
        best, which = max_distance + 1, -1
        for k in range(low[i], high[i]):
            j = order[k]
            disparity = uv[i, 0] - uv_right[j, 0]
            if not least <= disparity <= most or abs(level[i] - level_right[j]) > 1:
                continue
            d = hamming(words[i], words_right[j])
            if d < best:
                best, which = d, j
        if which >= 0 and best < owned[which]:
            if owner[which] >= 0:
                match[owner[which]] = -1
            owner[which], owned[which] = i, best
            match[i] = which


def _aligned(left: KeyPoints, right: KeyPoints, match: Array, smooth_left: Array,
             smooth_right: Array, config: StereoConfig) -> tuple[Array, Array]:
    """Disparities (N,) px to a fraction of a pixel, 0 where there is none, and their σ (N,)."""
    at = np.flatnonzero(match >= 0)
    disparity, sigma = np.zeros(len(left)), np.ones(len(left))
    start = np.stack([right.uv_px[match[at], 0], left.uv_px[at, 1]], axis=1)
    found = refine_matches(smooth_left, smooth_right, left.uv_px[at], start,
                           RefineConfig(prior_sigma_px=2.0, max_move_px=config.max_move_px,
                                        iterations=6),
                           direction=np.tile([1.0, 0.0], (len(at), 1)))
    d = left.uv_px[at, 0] - found.uv_current[:, 0]
    good = found.converged & (d >= config.min_disparity_px)
    disparity[at[good]] = d[good]
    sigma[at[good]] = np.sqrt(found.covariance[good, 0, 0])
    return disparity, sigma


def _lines_with_depth(left: KeyLines, right: KeyLines, K: float, config: StereoConfig,
                      shape: tuple[int, ...]) -> KeyLines:
    match = match_line_pairs(left, right, config, shape)
    disparity = line_disparities(left.ends_px, right.ends_px, match)
    known = (match >= 0) & (disparity >= config.min_disparity_px).all(axis=1)
    depth = np.where(known[:, None], K / np.where(known[:, None], disparity, 1.0), 0.0)
    return replace(left, depth_m=depth)


def fault_of_pair(left: KeyPoints, right: KeyPoints, config: StereoConfig) -> str:
    """Why two pictures are no rectified pair, left and right, or "".

    Told by points that look alike, wherever they are: of a pair they lie in one row, and farther
    left in the right picture.
    """
    match = match_all(as_words(left.descriptor), as_words(right.descriptor),
                      config.descriptor_distance, 0.7)
    at = np.flatnonzero(match >= 0)
    if len(at) < _ENOUGH:
        return ""
    shift = left.uv_px[at] - right.uv_px[match[at]]
    offset = float(np.median(np.abs(shift[:, 1])))
    if offset > config.row_px:
        return (f"stereo: points of the two pictures lie {offset:.1f} px apart in v in the median, "
                f"more than {config.row_px:g}: the pair is not rectified; rectify it first")
    if np.mean(shift[:, 0] < -config.min_disparity_px) > _SWAPPED_SHARE:
        return ("stereo: points lie farther right in the right picture: left and right are "
                "swapped; exchange them")
    return ""
