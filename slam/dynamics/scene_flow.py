"""Which objects move: their points' scene flow in all three coordinates, per second (III-C).

Estimated depth is smooth: a thing's pixels are all too near or too far, by an error that changes
over the thing and lasts from frame to frame. A camera that drives past then sees what stands move
along its epipolar lines, and grow or shrink. So what an error of depth explains is no motion:
across the ray, what lies on the point's epipolar line within `static_inverse_depth_error`; along
it, what the measured depths do not confirm, and what they jump by together from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam.config import DynamicConfig
from slam.geometry import se3
from slam.geometry.arrays import Array

_POINTS = 100          # of an object are enough to judge it by
_HYSTERESIS = 0.25     # a thing that moved goes on moving down to this share of the threshold
_BEYOND_DOUBT = 1.5    # times the limit: six standard deviations
_HIDES = 4.0           # times the threshold, noise is too large to tell that a thing stands
_RARE = 3.0            # times their usual jump, the depths of a small far thing jump now and then


class Followers(NamedTuple):
    """The points of one object that follow its motion from frame a to b."""

    xyz_a: Array     # (N, 3) m, in camera a
    rho_b: Array     # (N,) 1/m, as measured in b; nan where it was not


class CameraStep(NamedTuple):
    """What the static world tells between frames a and b."""

    T_a_b: Array           # (4, 4)
    information: Array     # (6, 6) of it
    dt_s: float
    depth_error: float     # 1/m, as `common_depth_error` measures it


class BodySteps(NamedTuple):
    """What G objects do between frames a and b."""

    relative: Array                   # (G, 4, 4) motions against the static world, in camera a
    information: Array                # (G, 6, 6) of their poses T_a_b
    followers: Sequence[Followers]
    moved_before: Array               # (G,) bool: known to move


def moving(camera: CameraStep, bodies: BodySteps, config: DynamicConfig) -> Array:
    """Whether (G,) objects' points move in the world: 0 no, 1 beyond threshold and noise, 2 also if
    depths jumped, 3 beyond doubt, −1 not to be told, for the noise would hide it.

    The scene flow is that of the object's own motion (eq. 4), `relative` p − p: the scene flow of
    single measured points is mostly depth noise, that of the motion which fits them all is not.
    What moved before needs to stand out less to go on moving.
    """
    sample = [f.xyz_a[:: max(1, len(f.xyz_a) // _POINTS)] for f in bodies.followers]
    count = np.array([len(points) for points in sample], dtype=np.int64)
    if count.sum() == 0:
        return np.zeros(len(count), np.int64)
    of = np.repeat(np.arange(len(count)), count)
    points = np.concatenate(sample)
    relative = bodies.relative[of]
    carried = np.einsum("nij,nj->ni", relative[:, :3, :3], points) + relative[:, :3, 3]
    T_b_a = se3.inverse(camera.T_a_b)
    across_m = _off_epipolar_line(T_b_a, points, carried, config.static_inverse_depth_error)
    along_m = _confirmed(points, carried, _depth_changes(T_b_a, bodies.followers)[of])
    threshold = config.static_scene_flow_m_s + config.static_share_of_distance * points[:, 2]
    threshold *= np.where(bodies.moved_before[of], _HYSTERESIS, 1.0)
    every = np.concatenate([camera.information[None], bodies.information])
    noise = speed_sigma(every, points, np.zeros_like(of)) + speed_sigma(every, points, 1 + of)
    limit_m = np.maximum(threshold * camera.dt_s, config.significance * noise)
    jump_m = config.depth_jumps * camera.depth_error * points[:, 2] ** 2
    level = np.zeros(len(count), np.int64)
    for times, jumps in ((1.0, 1.0), (1.0, _RARE), (_BEYOND_DOUBT, _RARE)):
        moved_m = np.hypot(across_m, np.maximum(along_m - jumps * jump_m, 0.0))
        level += (np.bincount(of, moved_m > times * limit_m, len(count))
                  > config.moving_share * count)
    hidden = np.bincount(of, limit_m > _HIDES * threshold * camera.dt_s, len(count)) > 0.5 * count
    return np.where((level == 0) & hidden, -1, level)


def _off_epipolar_line(T_b_a: Array, points_a: Array, carried_a: Array,
                       inverse_depth_error: float) -> Array:
    """How far (N,) m across the ray `carried_a` is seen from where its point might stand.

    A standing point whose inverse depth is wrong by δ is seen in b at x + g δ, on its epipolar
    line; the δ within bounds that comes nearest counts.
    """
    stands, moves = (se3.transform_points(T_b_a, p) for p in (points_a, carried_a))
    depth = np.maximum(stands[:, 2], 1e-6)
    x = stands[:, :2] / depth[:, None]
    t = T_b_a[:3, 3]
    g = (t[:2] - x * t[2]) * (points_a[:, 2] / depth)[:, None]
    gap = moves[:, :2] / np.maximum(moves[:, 2:], 1e-6) - x
    wanted = np.sum(gap * g, axis=1) / np.maximum(np.sum(g**2, axis=1), 1e-12)
    allowed = np.clip(wanted, -inverse_depth_error, inverse_depth_error)
    return np.asarray(np.linalg.norm(gap - g * allowed[:, None], axis=1) * depth)


def _depth_changes(T_b_a: Array, followers: Sequence[Followers]) -> Array:
    """By how much (G,) objects' inverse depths are seen to change, 1/m, beside standing.

    nan where no depth is known in b.
    """
    changes = np.full(len(followers), np.nan)
    for g, f in enumerate(followers):
        known = np.isfinite(f.rho_b)
        if known.any():
            depth = se3.transform_points(T_b_a, f.xyz_a[known])[:, 2]
            changes[g] = np.median(f.rho_b[known] - 1.0 / np.maximum(depth, 1e-6))
    return changes


def _confirmed(points_a: Array, carried_a: Array, rho_change: Array) -> Array:
    """The scene flow's size (N,) m along the ray, so far as the measured depths say the same.

    Args:
        rho_change: (N,) 1/m of the object that each point is of, as measured; nan is no objection.
    """
    rays = points_a / np.maximum(np.linalg.norm(points_a, axis=1, keepdims=True), 1e-9)
    along = np.sum((carried_a - points_a) * rays, axis=1)
    measured = -rho_change * points_a[:, 2] ** 2
    return np.where(np.isnan(measured), np.abs(along),
                    np.clip(measured * np.sign(along), 0.0, np.abs(along)))


def speed_sigma(information: Array, points: Array, of: Array) -> Array:
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
