"""Where the refinement starts: the prediction, or P3P in RANSAC (III-B) where that fits better."""

from __future__ import annotations

import numba
import numpy as np

from slam.config import StartConfig
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.resection import resect
from slam.matches import PointMatches
from slam.residuals import camera_tuple
from slam.tables import taken
from slam.types import Intrinsics

_LARGEST_TURN = 1.0    # rad from what is expected; a small thing's mirror image is farther
_FITS = 0.3            # of the cost that matches without any motion have: no search is needed
_CLEARLY = 0.95        # of another pose's cost: what is clearly better has less
_FINENESS = np.array([1.0, 0.5, 0.25, 0.125])   # of the threshold, at which a pose is judged
_JUDGED = 1000         # matches that tell which of two poses is better
_SEARCHED = ((1.0, 1), (0.25, 3))     # of the threshold, and of the iterations: two searches


def start_motion(points: PointMatches, camera: Intrinsics, config: StartConfig, sigma_px: float,
                 candidates: Array, own: Array | None = None) -> Array | None:
    """The pose T_a_b (4, 4) that the most matches support, or None with too few matches.

    Args:
        points: matches, of one rigid motion unless `own` says which are.
        sigma_px: standard deviation of their flow.
        candidates: (M, 4, 4) poses to try before P3P: the predicted motion, standing still.
        own: (K,) which of the matches move so; None: all.
    """
    own = np.arange(len(points)) if own is None else own
    sample, xyz = _sampled(points, own, camera, config.max_points)
    if len(sample) < config.min_points:
        return None
    threshold = max(config.threshold_px, 4.0 * sigma_px)
    coarse = truncated_costs(candidates, xyz, sample, camera, np.array([threshold]))
    best = int(np.argmin(coarse))
    if coarse[best] <= _FITS * len(sample):
        return np.array(candidates[best])
    poses = np.concatenate([candidates, *_searched(xyz, sample, camera, threshold, config,
                                                   candidates)])
    cost = truncated_costs(poses, xyz, sample, camera, threshold * _FINENESS)
    cost[: len(candidates)] *= _CLEARLY
    return np.array(poses[int(np.argmin(cost))])


def _sampled(points: PointMatches, own: Array, camera: Intrinsics, most: int
             ) -> tuple[PointMatches, Array]:
    """Evenly some of the matches `own` that have depth, and their points (K, 3) in a."""
    usable = own[points.rho_a[own] > 0]
    sample = taken(points, usable[:: max(1, len(usable) // most)])
    return sample, pinhole.back_project(camera, sample.uv_a, 1.0 / sample.rho_a)


def _searched(xyz: Array, sample: PointMatches, camera: Intrinsics, threshold_px: float,
              config: StartConfig, candidates: Array) -> list[Array]:
    """Poses (1, 4, 4) by P3P: of most support within the threshold, and within a part of it."""
    found = [resect(xyz, sample.uv_b, camera, part * threshold_px, times * config.iterations)
             for part, times in _SEARCHED]
    poses = [pose for pose, _ in filter(None, found)]
    turns = [se3.rotation_angle(np.swapaxes(candidates[:, :3, :3], 1, 2) @ T[:3, :3]).min()
             for T in poses]
    return [T[None] for T, turn in zip(poses, turns, strict=True) if turn < _LARGEST_TURN]


def drawn_away(start: Array, refined: Array, points: PointMatches, camera: Intrinsics,
               config: StartConfig, sigma_px: float, own: Array) -> bool:
    """Whether a pose (4, 4) fits the matches `own` (K,) clearly better than what came of it."""
    sample, xyz = _sampled(points, own, camera, _JUDGED)
    thresholds_px = max(config.threshold_px, 4.0 * sigma_px) * _FINENESS
    before, after = truncated_costs(np.stack([start, refined]), xyz, sample, camera, thresholds_px)
    return bool(before < _CLEARLY * after)


def truncated_costs(T_a_b: Array, xyz_a: Array, points: PointMatches, camera: Intrinsics,
                    thresholds_px: Array) -> Array:
    """Squared distances (M,), cut at 1, in the image and in the depth seen in b, of M poses.

    The unit is the threshold in the image and four standard deviations in the depth. The depth
    tells a pose from its mirror image, which a small thing's pixels hardly do.

    Args:
        thresholds_px: (K,) the costs of all are summed. Where two things move otherwise, a pose
            between the two has both within a wide threshold and fits neither.
    """
    return np.asarray(_truncated_costs(
        se3.inverse(T_a_b), xyz_a, points.uv_b, points.rho_b, points.rho_sigma_a,
        points.rho_sigma_b, camera_tuple(camera), thresholds_px))


@numba.njit(cache=True, nogil=True)
def _truncated_costs(T_b_a, xyz_a, uv_b, rho_b, sigma_a, sigma_b,  # type: ignore[no-untyped-def]
                     camera, thresholds):
    fx, fy, cx, cy = camera
    every = len(thresholds)
    costs = np.zeros(len(T_b_a))
    for m in range(len(T_b_a)):
        T = T_b_a[m]
        for n in range(len(xyz_a)):
            X, Y, Z = xyz_a[n]
            z = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
            if not z > 0.0:
                costs[m] += every
                continue
            du = fx * (T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]) / z + cx - uv_b[n, 0]
            dv = fy * (T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]) / z + cy - uv_b[n, 1]
            square = du * du + dv * dv
            for threshold in thresholds:
                part = square / (threshold * threshold)
                costs[m] += part if part < 1.0 else 1.0          # NaN counts 1
            if np.isfinite(sigma_b[n]):
                gap = (1.0 / z - rho_b[n]) / (4.0 * np.hypot(sigma_a[n], sigma_b[n]))
                costs[m] += every * min(gap * gap, 1.0)
    return costs
