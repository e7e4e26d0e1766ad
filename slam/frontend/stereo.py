"""Depth from a rectified stereo pair (semi-global matching)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slam.geometry.arrays import Array, ShapeError
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class StereoConfig:
    """Semi-global matching."""

    disparities: int = 128            # search range in px, a multiple of 16; 3 m on KITTI
    block_px: int = 5
    left_right_px: int = 1            # largest difference of the two matchings
    uniqueness_percent: int = 10      # margin of the best cost over the second
    speckle_px: int = 100             # smaller islands of one disparity are dropped
    speckle_range: int = 2            # px of disparity within an island
    min_disparity_px: float = 1.0     # farther than this the depth says nothing


def depth_from_stereo(left: Array, right: Array, intrinsics: Intrinsics,
                      config: StereoConfig | None = None) -> Array:
    """Depth of the left image's pixels.

    Args:
        left: (H, W, 3) or (H, W) uint8, rectified.
        right: the same shape.
        intrinsics: with `baseline_m`.
    Returns:
        (H, W) float32 z-depth in metres, 0 where there is none.
    Raises:
        ShapeError: the images differ in shape.
        ValueError: the intrinsics have no baseline.
    """
    config = StereoConfig() if config is None else config
    if left.shape != right.shape:
        raise ShapeError(f"right image: wanted shape {left.shape}, got {right.shape}")
    if intrinsics.baseline_m is None:
        raise ValueError("depth from stereo needs Intrinsics.baseline_m, which is None")
    matcher = cv2.StereoSGBM_create(
        minDisparity=0, numDisparities=config.disparities, blockSize=config.block_px,
        P1=8 * config.block_px ** 2, P2=32 * config.block_px ** 2,
        disp12MaxDiff=config.left_right_px, uniquenessRatio=config.uniqueness_percent,
        speckleWindowSize=config.speckle_px, speckleRange=config.speckle_range,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    # The left strip that the right camera cannot see would be lost to the search range.
    pad = config.disparities
    gray_left, gray_right = (cv2.copyMakeBorder(_gray(image), 0, 0, pad, 0, cv2.BORDER_REPLICATE)
                             for image in (left, right))
    disparity = matcher.compute(gray_left, gray_right)[:, pad:].astype(np.float32) / 16.0
    depth = np.zeros_like(disparity)
    column = np.arange(disparity.shape[1], dtype=np.float32)
    known = (disparity >= config.min_disparity_px) & (disparity <= column)
    depth[known] = intrinsics.fx * intrinsics.baseline_m / disparity[known]
    return depth


def _gray(image: Array) -> Array:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
