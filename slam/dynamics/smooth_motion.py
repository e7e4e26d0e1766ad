"""Objects keep their velocity: each measured motion is joined with what the ones before it lead to.

The smooth-motion factor of the batch (EQUATIONS 5), taken frame by frame as a Kalman filter. The
velocity is that of a frame fixed to the body, in which a car that turns drives straight on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam.config import SmoothMotionConfig
from slam.geometry import se3
from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """How rigid bodies move, and where they are; one, or several in a leading axis."""

    stamp_s: float
    T_world_body: Array      # (..., 4, 4) now; where a body's frame lies in it is arbitrary
    twist: Array             # (..., 6) [ω rad/s, v m/s] in the body's frame
    covariance: Array        # (..., 6, 6) of the twist

    def of(self, body: int) -> BodyVelocity:
        """One of several."""
        return BodyVelocity(self.stamp_s, self.T_world_body[body], self.twist[body],
                            self.covariance[body])

    def motion(self, dt_s: float) -> tuple[Array, Array]:
        """H_world (..., 4, 4) that brought the bodies here in the last `dt_s`, and the
        covariances of H Exp(ξ)."""
        step = se3.exp(self.twist * dt_s)
        before = self.T_world_body @ se3.inverse(step)
        return (se3.orthonormalised(before @ step @ se3.inverse(before)),
                _carried(se3.adjoint(before) * dt_s, self.covariance))


@dataclass(frozen=True, slots=True)
class MeasuredMotions:
    """The motions of G bodies between two frames, as the matches between them have it."""

    H_world: Array           # (G, 4, 4)
    covariance: Array        # (G, 6, 6) of H Exp(ξ)
    place_world: Array       # (G, 3) m, where the frame of a new body begins
    before_s: float
    stamp_s: float


def keep_moving(before: Sequence[BodyVelocity | None], measured: MeasuredMotions,
                config: SmoothMotionConfig) -> BodyVelocity:
    """The velocities of the G bodies after one more measured motion.

    What contradicts all that went before (a collision, or a wrong measurement) starts anew, and so
    does what was not seen in the frame before.

    Args:
        before: of each body; None where nothing is known.
    """
    dt_s = measured.stamp_s - measured.before_s
    known = [v if v is not None and v.stamp_s == measured.before_s else None for v in before]
    T_world_body = se3.from_rotation_translation(np.eye(3), measured.place_world)
    for body, velocity in enumerate(known):
        if velocity is not None:
            T_world_body[body] = velocity.T_world_body
    T_body_world = se3.inverse(T_world_body)
    twist = se3.log(T_body_world @ measured.H_world @ T_world_body) / dt_s
    covariance = _carried(se3.adjoint(T_body_world) / dt_s, measured.covariance)
    old = np.array([body for body, v in enumerate(known) if v is not None], dtype=np.int64)
    if len(old):
        was = [v for v in known if v is not None]
        twist[old], covariance[old] = _joined(
            np.array([v.twist for v in was]), np.array([v.covariance for v in was]),
            twist[old], covariance[old], dt_s, config)
    return BodyVelocity(measured.stamp_s, T_world_body @ se3.exp(twist * dt_s), twist, covariance)


def _carried(A: Array, covariance: Array) -> Array:
    return np.asarray(A @ covariance @ np.swapaxes(A, -1, -2))


def _joined(before: Array, covariance_before: Array, twist: Array, covariance: Array, dt_s: float,
            config: SmoothMotionConfig) -> tuple[Array, Array]:
    """The Kalman updates; the measurements alone where they are not to be reconciled."""
    change = np.repeat([config.angular_acceleration_rad_s2, config.acceleration_m_s2], 3) * dt_s
    expected = covariance_before + np.diag(change**2)
    innovation = (twist - before)[..., None]
    solved = np.linalg.solve(expected + covariance, np.concatenate([expected, innovation], axis=-1))
    gain = np.swapaxes(solved[..., :6], -1, -2)
    chi2 = np.sum(innovation[..., 0] * solved[..., 6], axis=-1)
    joined = (np.eye(6) - gain) @ expected
    fits = chi2 < config.gate_chi2
    return (np.where(fits[:, None], before + (gain @ innovation)[..., 0], twist),
            np.where(fits[:, None, None], 0.5 * (joined + np.swapaxes(joined, -1, -2)), covariance))
