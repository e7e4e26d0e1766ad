"""Which pixels of a patch lie on the surface of its centre, by depth and mask."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry.arrays import Array

SAME_SURFACE = 0.08   # of log depth over a patch's radius: 8 %, a plane at 80° 5 px off at f = 500

_NOISY_FROM_M = 20.0   # 0.002 z² is 4 % there, a quarter of it after the median filter


def surface_image(depth_m: Array, instance_id: Array | None = None) -> Array:
    """(H, W) float32 that tells surfaces apart: log depth, a step apart for each instance.

    Depth noise grows with the square of the distance: the depth is median filtered, and its log
    saturates where even so the noise is as large as the step that tells two surfaces apart.

    Pixels next to a step in it are NaN: blur has mixed both sides there.
    """
    known = np.asarray(depth_m) > 0
    # Without depth is a surface of its own, nearer than any other.
    depth = cv2.medianBlur(np.where(known, depth_m, 1e-3).astype(np.float32), 5)
    image = np.log(depth / (1.0 + depth / _NOISY_FROM_M))
    if instance_id is not None:
        image += np.float32(16.0) * instance_id.astype(np.float32)
    box = np.ones((3, 3), np.uint8)
    image[cv2.dilate(image, box) - cv2.erode(image, box) > SAME_SURFACE] = np.nan
    return image


def patch_support(surface: Array, uv_px: Array, radius: int) -> Array:
    """(P, N) bool: which pixels of the patches lie on the surface of the patch's centre."""
    side = 2 * radius + 1
    if len(uv_px) == 0:     # as of a picture that is smaller than a patch
        return np.zeros((side * side, 0), np.bool_)
    whole = np.rint(uv_px).astype(np.intp)
    windows = np.lib.stride_tricks.sliding_window_view(surface, (side, side))
    cut = np.ascontiguousarray(windows[whole[:, 1] - radius, whole[:, 0] - radius]
                               .reshape(len(uv_px), side * side).T)
    return np.asarray(np.abs(cut - cut[len(cut) // 2]) <= SAME_SURFACE)
