"""Where the refinement starts: P3P in RANSAC (III-B), or the prediction if that fits better."""

from __future__ import annotations

import cv2
import numpy as np

from slam.config import StartConfig
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import PointMatches, take
from slam.types import Intrinsics

_LARGEST_TURN = 1.0    # rad from what is expected; a small thing's mirror image is farther


def start_motion(points: PointMatches, camera: Intrinsics, config: StartConfig, sigma_px: float,
                 candidates: Array) -> Array | None:
    """The pose T_a_b (4, 4) that the most matches support, or None with too few matches.

    Args:
        points: matches of one rigid motion.
        sigma_px: standard deviation of their flow.
        candidates: (M, 4, 4) poses to try besides P3P's: the predicted motion, standing still.
    """
    usable = np.flatnonzero(points.rho_a > 0)
    if len(usable) < config.min_points:
        return None
    step = max(1, len(usable) // config.max_points)
    sample = take(points, usable[::step])
    xyz = pinhole.back_project(camera, sample.uv_a, 1.0 / sample.rho_a)
    threshold = max(config.threshold_px, 4.0 * sigma_px)
    tried = [*candidates]
    found, rotation, translation, _ = cv2.solvePnPRansac(
        xyz, sample.uv_b, camera.matrix, None, iterationsCount=config.iterations,
        reprojectionError=threshold, confidence=0.999, flags=cv2.SOLVEPNP_P3P)
    if found and np.isfinite(rotation).all() and np.isfinite(translation).all():
        T_b_a = se3.from_rotation_translation(se3.exp_so3(rotation[:, 0]), translation[:, 0])
        T_a_b = se3.inverse(T_b_a)
        turn = se3.rotation_angle(np.swapaxes(candidates[:, :3, :3], 1, 2) @ T_a_b[:3, :3])
        if turn.min() < _LARGEST_TURN:
            tried.append(T_a_b)
    return min(tried, key=lambda T: _truncated_cost(T, xyz, sample, camera, threshold))


def _truncated_cost(T_a_b: Array, xyz: Array, points: PointMatches, camera: Intrinsics,
                    threshold_px: float) -> float:
    """Squared distances, cut at the threshold, in the image and in the depth seen in b.

    The depth tells a pose from its mirror image, which a small thing's pixels hardly do.
    """
    xyz_b = se3.transform_points(se3.inverse(T_a_b), xyz)
    square = np.sum((pinhole.project(camera, xyz_b) - points.uv_b) ** 2, axis=1)
    square = np.minimum(np.nan_to_num(square, nan=np.inf) / threshold_px**2, 1.0)
    known = np.isfinite(points.rho_sigma_b) & (xyz_b[:, 2] > 0)
    sigma = np.hypot(points.rho_sigma_a, np.where(known, points.rho_sigma_b, 1.0))
    gap = 1.0 / np.where(known, xyz_b[:, 2], 1.0) - points.rho_b
    return float(square.sum() + np.minimum((gap / (4.0 * sigma)) ** 2, 1.0)[known].sum())
