"""Points followed between two pictures, and what the epipolar constraint says of them (III-B.1)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slam.frontend.sampling import inside, nearest
from slam.geometry.arrays import Array

_MIN_FOR_F = 15          # matches for a fundamental matrix with a margin over its 8
_PATCH = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(9, 2)


@dataclass(frozen=True, slots=True)
class Followed:
    """Pixels in the previous picture and where each is in this one."""

    before_px: Array     # (N, 2)
    now_px: Array        # (N, 2)
    good: Array          # (N,) bool: found, off the border, and looking the same


def corners(gray: Array, count: int, min_distance_px: float = 8.0) -> Array:
    """(N, 2) the strongest corners of an image (H, W) uint8 (Shi and Tomasi's Harris)."""
    found = cv2.goodFeaturesToTrack(gray, count, 0.005, min_distance_px)
    return np.zeros((0, 2)) if found is None else np.asarray(found.reshape(-1, 2), np.float64)


def follow(gray_before: Array, gray_now: Array, before_px: Array, border_px: float,
           patch_difference: float, expected_px: Array | None = None) -> Followed:
    """Pyramidal Lucas-Kanade; pairs near the border or with patches unlike each other are bad.

    Args:
        before_px: (N, 2).
        patch_difference: largest mean absolute difference of the 3×3 patches, grey levels.
        expected_px: (N, 2) where the search starts; None: at the same place.
    """
    if not len(before_px):
        return Followed(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, bool))
    start = before_px if expected_px is None else np.where(
        np.isfinite(expected_px), expected_px, before_px)
    now, found, _ = cv2.calcOpticalFlowPyrLK(
        gray_before, gray_now, before_px.astype(np.float32)[:, None],
        start.astype(np.float32)[:, None].copy(), winSize=(15, 15), maxLevel=3,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.02),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    now = now[:, 0].astype(np.float64)
    alike = np.abs(nearest(gray_before, before_px[:, None] + _PATCH).astype(np.float64)
                   - nearest(gray_now, now[:, None] + _PATCH)).mean(axis=1) <= patch_difference
    good = (found[:, 0] > 0) & alike & inside(now, gray_now.shape, border_px) & inside(
        before_px, gray_before.shape, border_px)
    return Followed(before_px, now, good)


def fundamental(before_px: Array, now_px: Array, threshold_px: float) -> Array | None:
    """F (3, 3) with P₂ᵀ F P₁ = 0 that most pairs support, by RANSAC; None with too few."""
    if len(before_px) < _MIN_FOR_F:
        return None
    F, _ = cv2.findFundamentalMat(before_px, now_px, cv2.FM_RANSAC, threshold_px, 0.99, 500)
    return F if F is not None and F.shape == (3, 3) and np.isfinite(F).all() else None


def epipolar_distance(F: Array, before_px: Array, now_px: Array) -> Array:
    """Distances (N,) in px from the epipolar lines: eq. (3), L = F P₁, and eq. (4).

    D = |P₂ᵀ F P₁| / √(X² + Y²); a pair on the epipole, which has no line, is at distance 0.
    """
    lines = _homogeneous(before_px) @ F.T
    norm = np.hypot(lines[:, 0], lines[:, 1])
    off = np.abs(np.sum(_homogeneous(now_px) * lines, axis=1))
    return np.where(norm > 1e-12, off / np.where(norm > 1e-12, norm, 1.0), 0.0)


def _homogeneous(uv: Array) -> Array:
    return np.concatenate([uv, np.ones((len(uv), 1))], axis=1)
