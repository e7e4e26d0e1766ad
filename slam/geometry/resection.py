"""A camera's pose from landmarks and their pixels: P3P in RANSAC."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole
from slam.spread import sigma_of_lengths

_CONFIDENCE = 0.999      # that one of the samples held no outlier
_ROUNDS, _GATE = 4, 2.5  # of the refinement, on supporters within so many standard deviations
_FEWEST = 6              # supporters that are refined on


def resect(xyz_world: Array, uv_px: Array, camera: Pinhole, threshold_px: float, tries: int
           ) -> tuple[Array, Array] | None:
    """The pose T_world_camera (4, 4) that most pixels support, and which (N,) bool support it.

    None where fewer than four landmarks (N, 3) are given or no sample leads to a pose.

    Args:
        threshold_px: largest reprojection error of a supporter.
        tries: samples drawn, at most; equal input draws equal ones.
    """
    if len(xyz_world) < 4:
        return None
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        xyz_world, uv_px, K, None, iterationsCount=tries,
        reprojectionError=threshold_px, confidence=_CONFIDENCE, flags=cv2.SOLVEPNP_P3P)
    if not found or inliers is None:
        return None
    supporters = inliers[:, 0]
    for _ in range(_ROUNDS):
        # RANSAC ends with EPnP on all supporters, which far landmarks of noisy depth lead astray,
        # as a thing does that moves by less than the threshold.
        rotation, translation = cv2.solvePnPRefineLM(
            xyz_world[supporters], uv_px[supporters], K, None, rotation, translation)
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            return None
        seen, _ = cv2.projectPoints(xyz_world, rotation, translation, K, None)
        off = np.linalg.norm(seen[:, 0] - uv_px, axis=1)
        gate = min(threshold_px, _GATE * sigma_of_lengths(off[supporters]))
        supporters = np.flatnonzero(off <= gate)
        if len(supporters) < _FEWEST:
            break
    T_camera_world = se3.from_rotation_translation(se3.exp_so3(rotation[:, 0]), translation[:, 0])
    return se3.inverse(T_camera_world), np.asarray(off <= threshold_px)
