"""Which objects move: their points' scene flow in all three coordinates, per second (III-C)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.config import DynamicConfig
from slam.geometry.arrays import Array

_POINTS = 100          # of an object are enough to judge it by
_HYSTERESIS = 0.25     # a thing that moved goes on moving down to this share of the threshold
_BEYOND_DOUBT = 1.5    # times the limit: six standard deviations


def moving(relative: Array, information_static: Array, information_objects: Array,
           points_a: Sequence[Array], dt_s: float, config: DynamicConfig,
           moved_before: Array | None = None) -> Array:
    """Whether (G,) objects' points move in the world: 0 no, 1 beyond threshold and noise, 2 beyond
    doubt.

    The scene flow is that of the object's own motion (eq. 4), `relative` p − p: the scene flow of
    single measured points is mostly depth noise, that of the motion which fits them all is not.

    Args:
        relative: (G, 4, 4) motions of the objects against the static world, in camera a.
        information_static: (6, 6) of the static world's pose T_a_b.
        information_objects: (G, 6, 6) of the objects'.
        points_a: of each object (N, 3), its points in camera a, m.
        moved_before: (G,) objects known to move need to stand out less to go on moving.
    """
    sample = [points[:: max(1, len(points) // _POINTS)] for points in points_a]
    count = np.array([len(points) for points in sample], dtype=np.int64)
    if count.sum() == 0:
        return np.zeros(len(count), np.int64)
    of = np.repeat(np.arange(len(count)), count)
    points = np.concatenate(sample)
    flow_m = np.einsum("nij,nj->ni", relative[of, :3, :3], points) + relative[of, :3, 3] - points
    speed = np.linalg.norm(_beyond_depth_error(flow_m, points, config), axis=1) / dt_s
    threshold = config.static_scene_flow_m_s + config.static_share_of_distance * points[:, 2]
    if moved_before is not None:
        threshold = np.where(moved_before[of], _HYSTERESIS, 1.0) * threshold
    every = np.concatenate([information_static[None], information_objects])
    noise = _speed_sigma(every, points, np.zeros_like(of)) + _speed_sigma(every, points, 1 + of)
    excess = speed / np.maximum(threshold, config.significance * noise / dt_s)
    return np.sum([np.bincount(of, excess > limit, len(count)) > config.moving_share * count
                   for limit in (1.0, _BEYOND_DOUBT)], axis=0)


def _beyond_depth_error(flow_m: Array, points_a: Array, config: DynamicConfig) -> Array:
    """The scene flow less what a common error of the object's depths would give along the ray."""
    rays = points_a / np.maximum(np.linalg.norm(points_a, axis=1, keepdims=True), 1e-9)
    along = np.sum(flow_m * rays, axis=1)
    allowed = config.common_inverse_depth_error * points_a[:, 2] ** 2
    return flow_m - np.clip(along, -allowed, allowed)[:, None] * rays


def _speed_sigma(information: Array, points: Array, of: Array) -> Array:
    """Standard deviations (N,) in m of points p carried by poses: of ω × p + v.

    Its variance is tr Σ_v + |p|² tr Σ_ω − pᵀ Σ_ω p + 2 p · E[v × ω].

    Args:
        information: (P, 6, 6) of the poses; of: (N,) which one carries each point.
    """
    trace = np.maximum(np.trace(information, axis1=1, axis2=2), 1e-12)
    covariance = np.linalg.inv(information + 1e-9 * trace[:, None, None] * np.eye(6))
    of_rotation, across = covariance[:, :3, :3], covariance[:, 3:, :3]
    v_cross_w = np.stack([across[:, 1, 2] - across[:, 2, 1], across[:, 2, 0] - across[:, 0, 2],
                          across[:, 0, 1] - across[:, 1, 0]], axis=1)
    quadratic = np.trace(of_rotation, axis1=1, axis2=2)[:, None, None] * np.eye(3) - of_rotation
    variance = (np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2)[of]
                + np.einsum("ni,nij,nj->n", points, quadratic[of], points)
                + 2.0 * np.sum(points * v_cross_w[of], axis=1))
    return np.sqrt(np.maximum(variance, 0.0))
