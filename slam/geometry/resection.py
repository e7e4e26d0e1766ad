"""A camera's pose from landmarks and their pixels: P3P in RANSAC."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole

_CONFIDENCE = 0.999      # that one of the samples held no outlier


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
    # RANSAC ends with EPnP on all supporters, which far landmarks of noisy depth lead astray.
    rotation, translation = cv2.solvePnPRefineLM(
        xyz_world[inliers[:, 0]], uv_px[inliers[:, 0]], K, None, rotation, translation)
    if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        return None
    T_camera_world = se3.from_rotation_translation(se3.exp_so3(rotation[:, 0]), translation[:, 0])
    fits = np.zeros(len(xyz_world), np.bool_)
    fits[inliers[:, 0]] = True
    return se3.inverse(T_camera_world), fits
