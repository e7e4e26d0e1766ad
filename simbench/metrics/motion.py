"""The per-frame motion error of the VDO-SLAM and SDPL-SLAM tables: E = T̂⁻¹ T."""

from __future__ import annotations

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array


def motion_errors(T_estimated: Array, T_true: Array) -> tuple[Array, Array]:
    """E_t and E_R of motions: the translation (m) and angle (deg) of E = T̂⁻¹ T.

    Args:
        T_estimated, T_true: (..., 4, 4) motions in the same body frame.
    Returns:
        (...) metres and (...) degrees; the angle is exact near zero.
    """
    E = se3.inverse(T_estimated) @ np.asarray(T_true, dtype=np.float64)
    return (np.linalg.norm(E[..., :3, 3], axis=-1),
            np.degrees(se3.rotation_angle(E[..., :3, :3])))


def increments(T_world_body: Array) -> Array:
    """(K-1, 4, 4) body-frame motions T_previous_body between neighbouring poses (K, 4, 4)."""
    return se3.inverse(T_world_body[:-1]) @ T_world_body[1:]


def body_motion(T_world_object: Array, H_world: Array) -> Array:
    """A world motion seen in the object's body frame: L⁻¹ H L, all (..., 4, 4).

    With L the true pose before the motion and H = L' L⁻¹ this is L⁻¹ L'.
    """
    return se3.inverse(T_world_object) @ H_world @ T_world_object


def moved_to_world(T_b_a: Array, H_a: Array) -> Array:
    """A motion of points in frame a as a motion of points in frame b: S H S⁻¹."""
    return np.asarray(T_b_a @ H_a @ se3.inverse(T_b_a))
