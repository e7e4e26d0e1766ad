"""Correspondences between two views whose motions and noise are known exactly."""

from __future__ import annotations

import numpy as np

from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.types import Intrinsics

CAMERA = Intrinsics(400.0, 410.0, 319.5, 239.5, 640, 480)


def some_motion(rng: np.random.Generator, turn_rad: float = 0.03, step_m: float = 0.1) -> Array:
    """(4, 4) pose of camera b in a, as between two frames."""
    return np.asarray(se3.exp(np.r_[rng.normal(size=3) * turn_rad, rng.normal(size=3) * step_m]))


def perturbed(T: Array, rng: np.random.Generator, turn_rad: float = 0.01,
              step_m: float = 0.03) -> Array:
    """Poses (..., 4, 4) moved a little."""
    xi = rng.normal(size=(*np.shape(T)[:-2], 6)) * np.r_[[turn_rad] * 3, [step_m] * 3]
    return np.asarray(T @ se3.exp(xi))


def seen_in_b(T_a_b: Array, uv_a: Array, rho_a: Array) -> tuple[Array, Array]:
    """Pixels (..., 2) and inverse depths (...) in b of points of a."""
    points = pinhole.rays(CAMERA, uv_a) / rho_a[..., None]
    moved = se3.transform_points(se3.inverse(T_a_b), points.reshape(-1, 3)).reshape(points.shape)
    return pinhole.project(CAMERA, moved), 1.0 / moved[..., 2]


def random_points(rng: np.random.Generator, T_a_b: Array, n: int, flow_sigma: float = 0.3,
                  rho_sigma: float = 0.002, group: int = 0, kind: int = 0,
                  assumed_flow: float | None = None, assumed_rho: float | None = None,
                  known_b: bool = True, slope: float = 0.0) -> PointMatches:
    """n points of one motion with Gaussian noise in flow and in both inverse depths.

    The second depth is read where the wrong flow leads, on surfaces with slopes of this size.
    """
    uv_a = rng.uniform([20, 20], [620, 460], size=(n, 2))
    rho = 1.0 / rng.uniform(1.5, 7.0, size=n)
    uv_b, rho_b = seen_in_b(T_a_b, uv_a, rho)
    flow_said = flow_sigma if assumed_flow is None else assumed_flow
    rho_said = rho_sigma if assumed_rho is None else assumed_rho
    rho_a = rho + rho_sigma * rng.normal(size=n)
    missed = flow_sigma * rng.normal(size=(n, 2))
    read = rho_b + rho_sigma * rng.normal(size=n)
    slopes = slope * rng.normal(size=(n, 2)) if slope else np.zeros((n, 2))
    return PointMatches(
        uv_a, rho_a, np.full(n, rho_said), uv_b + missed,
        np.repeat(flow_said**2 * np.eye(2)[None], n, 0), read + np.sum(slopes * missed, axis=1),
        np.full(n, rho_said if known_b else np.inf), slopes, np.full(n, group), np.full(n, kind))


def random_lines(rng: np.random.Generator, T_a_b: Array, n: int, flow_sigma: float = 0.1,
                 rho_sigma: float = 0.0005, group: int = 0) -> LineMatches:
    """n long segments of one motion with Gaussian noise in both ends' flow and inverse depth."""
    middle = rng.uniform([180, 150], [460, 330], size=(n, 1, 2))
    angle = rng.uniform(0, np.pi, size=n)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]
    half = rng.uniform(60, 120, size=(n, 1, 1)) * np.array([-1.0, 1.0])[None, :, None]
    ends_a = middle + half * along
    rho = 1.0 / rng.uniform(1.5, 6.0, size=(n, 2))
    ends_b, _ = seen_in_b(T_a_b, ends_a, rho)
    return LineMatches(ends_a, rho + rho_sigma * rng.normal(size=(n, 2)),
                       np.full((n, 2), rho_sigma),
                       ends_b + flow_sigma * rng.normal(size=(n, 2, 2)),
                       np.full(n, flow_sigma), np.full(n, group))


def no_points() -> PointMatches:
    """An empty set of point matches."""
    none = np.zeros(0)
    return PointMatches(np.zeros((0, 2)), none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), none,
                        none, np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0, np.int64))
