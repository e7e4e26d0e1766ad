"""Objects keep their velocity: each measured motion is joined with what the ones before it lead to.

The smooth-motion factor of the batch (EQUATIONS 5), taken frame by frame as a Kalman filter. The
velocity is that of a frame fixed to the body, in which a car that turns drives straight on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.config import SmoothMotionConfig
from slam.geometry import se3
from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """How a rigid body moves, and where it is."""

    stamp_s: float
    T_world_body: Array      # (4, 4) at this time; where the body's frame lies in it is arbitrary
    twist: Array             # (6,) [ω rad/s, v m/s] in the body's frame
    covariance: Array        # (6, 6) of the twist

    def motion(self, dt_s: float) -> tuple[Array, Array]:
        """H_world (4, 4) that brought the body here in the last `dt_s`; covariance of H Exp(ξ)."""
        step = se3.exp(self.twist * dt_s)
        before = self.T_world_body @ se3.inverse(step)
        A = se3.adjoint(before) * dt_s
        return se3.orthonormalised(before @ step @ se3.inverse(before)), A @ self.covariance @ A.T


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """A body's motion between two frames, as the matches between them have it."""

    H_world: Array           # (4, 4)
    covariance: Array        # (6, 6) of H Exp(ξ)
    before_s: float
    stamp_s: float


def keep_moving(before: BodyVelocity | None, measured: MeasuredMotion, place_world: Array,
                config: SmoothMotionConfig) -> BodyVelocity:
    """The velocity after one more measured motion.

    What contradicts all that went before (a collision, or a wrong measurement) starts anew, and so
    does what was not seen in the frame before.

    Args:
        before: None where nothing is known.
        place_world: (3,) m, where a body's frame begins.
    """
    dt_s = measured.stamp_s - measured.before_s
    if before is not None and before.stamp_s != measured.before_s:
        before = None
    T_world_body = (se3.from_rotation_translation(np.eye(3), place_world) if before is None
                    else before.T_world_body)
    T_body_world = se3.inverse(T_world_body)
    twist = se3.log(T_body_world @ measured.H_world @ T_world_body) / dt_s
    A = se3.adjoint(T_body_world) / dt_s
    covariance = A @ measured.covariance @ A.T
    if before is not None:
        twist, covariance = _joined(before, twist, covariance, dt_s, config)
    return BodyVelocity(measured.stamp_s, T_world_body @ se3.exp(twist * dt_s), twist, covariance)


def _joined(before: BodyVelocity, twist: Array, covariance: Array, dt_s: float,
            config: SmoothMotionConfig) -> tuple[Array, Array]:
    """The Kalman update; the measurement alone where it is not to be reconciled."""
    change = np.repeat([config.angular_acceleration_rad_s2, config.acceleration_m_s2], 3) * dt_s
    expected = before.covariance + np.diag(change**2)
    innovation = twist - before.twist
    gain = np.linalg.solve(expected + covariance, expected).T
    chi2 = innovation @ np.linalg.solve(expected + covariance, innovation)
    if not chi2 < config.gate_chi2:
        return twist, covariance
    joined = (np.eye(6) - gain) @ expected
    return before.twist + gain @ innovation, 0.5 * (joined + joined.T)
