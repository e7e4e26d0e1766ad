"""The camera's step found by features alone, where nothing tells what to expect of it.

Dense flow that starts from nothing keeps plain roads and walls where they were, however fast the
camera moves: of the steps that fit such flow the smallest wins. Features that look alike are found
wherever they went.
"""

from __future__ import annotations

import cv2
import numpy as np

from slam.frontend.flow import predicted_flow
from slam.frontend.observe import Observation
from slam.frontend.picture import static_gaps
from slam.frontend.sampling import nearest
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project
from slam.geometry.resection import resect
from slam.types import Intrinsics

_FEATURES, _FAST_THRESHOLD, _BORDER_PX = 1500, 7, 15
_RATIO = 0.8             # best over second best
_MIN_SUPPORT = 12        # matches that fit one pose
_RANSAC_PX, _RANSAC_TRIES = 2.0, 1000
_CLEARLY = 0.9           # of the difference of the pictures as they are


def find_step(a: Observation, b: Observation, camera: Intrinsics) -> Array:
    """The step T_a_b (4, 4) by features; none, if that explains the pictures as well.

    What lies in masks has no say.
    """
    uv_a, uv_b = _alike(a, b)
    rho = nearest(a.rho, uv_a)
    known = rho > 0
    found = resect(back_project(camera, uv_a[known], 1.0 / rho[known]), uv_b[known], camera,
                   _RANSAC_PX, _RANSAC_TRIES)
    if found is None or np.count_nonzero(found[1]) < _MIN_SUPPORT:
        return np.eye(4)
    moved = predicted_flow(a.frame.depth_m, a.label_index, se3.inverse(found[0]), {}, camera)
    without, with_it = static_gaps(np.zeros_like(moved), moved, a.label_index, a.gray, b.gray)
    return found[0] if with_it < _CLEARLY * without else np.eye(4)


def _alike(a: Observation, b: Observation) -> tuple[Array, Array]:
    """Pixels (N, 2) of both pictures, off their masks, whose ORB descriptors match."""
    if min(a.gray.shape) <= 2 * _BORDER_PX:   # all border; OpenCV raises where there is no pyramid
        return np.zeros((0, 2)), np.zeros((0, 2))
    orb = cv2.ORB_create(_FEATURES, edgeThreshold=_BORDER_PX, fastThreshold=_FAST_THRESHOLD)
    (at_a, words_a), (at_b, words_b) = (
        orb.detectAndCompute(each.gray, (each.label_index == 0).astype(np.uint8))
        for each in (a, b))
    if words_a is None or words_b is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    pairs = [near[0] for near in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(words_a, words_b, k=2)
             if len(near) == 2 and near[0].distance < _RATIO * near[1].distance]
    return (np.array([at_a[m.queryIdx].pt for m in pairs]).reshape(-1, 2),
            np.array([at_b[m.trainIdx].pt for m in pairs]).reshape(-1, 2))
