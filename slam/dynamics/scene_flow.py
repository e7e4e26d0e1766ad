"""Which objects move: their points' scene flow in all three coordinates, per second (III-C)."""

from __future__ import annotations

import numpy as np

from slam.config import DynamicConfig
from slam.geometry import se3
from slam.geometry.arrays import Array

_POINTS = 100          # of an object are enough to judge it by
_HYSTERESIS = 0.25     # a thing that moved goes on moving down to this share of the threshold


def moves(relative: Array, information_static: Array, information_object: Array, points_a: Array,
          dt_s: float, config: DynamicConfig, moved_before: bool = False) -> bool:
    """Whether an object's points move in the world, beyond threshold and noise.

    The scene flow is that of the object's own motion (eq. 4), `relative` p − p: the scene flow of
    single measured points is mostly depth noise, that of the motion which fits them all is not.

    Args:
        relative: (4, 4) motion of the object against the static world, in camera a.
        information_static, information_object: (6, 6) of both poses T_a_b.
        points_a: (N, 3) the object's points in camera a, m.
        moved_before: an object known to move needs to stand out less to go on moving.
    """
    if len(points_a) == 0:
        return False
    points_a = points_a[:: max(1, len(points_a) // _POINTS)]
    flow_m = se3.transform_points(relative, points_a) - points_a
    speed = np.linalg.norm(_beyond_depth_error(flow_m, points_a, config), axis=1) / dt_s
    threshold = config.static_scene_flow_m_s + config.static_share_of_distance * points_a[:, 2]
    if moved_before:
        threshold *= _HYSTERESIS
    noise = _speed_sigma(information_static, points_a) + _speed_sigma(information_object, points_a)
    moving = speed > np.maximum(threshold, config.significance * noise / dt_s)
    return bool(np.mean(moving) > config.moving_share)


def _beyond_depth_error(flow_m: Array, points_a: Array, config: DynamicConfig) -> Array:
    """The scene flow less what a common error of the object's depths would give along the ray."""
    rays = points_a / np.maximum(np.linalg.norm(points_a, axis=1, keepdims=True), 1e-9)
    along = np.sum(flow_m * rays, axis=1)
    allowed = config.common_inverse_depth_error * points_a[:, 2] ** 2
    return flow_m - np.clip(along, -allowed, allowed)[:, None] * rays


def _speed_sigma(information: Array, points: Array) -> Array:
    """Standard deviation (N,) in m of points carried by a pose of this information."""
    regular = information + np.eye(6) * 1e-9 * max(float(np.trace(information)), 1e-12)
    covariance = np.linalg.inv(regular)
    J = np.concatenate([-se3.skew(points), np.broadcast_to(np.eye(3), (len(points), 3, 3))], axis=2)
    return np.sqrt(np.maximum(np.einsum("nij,jk,nik->n", J, covariance, J), 0.0))
