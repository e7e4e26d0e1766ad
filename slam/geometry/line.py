"""Infinite 3D lines: Plücker coordinates, the orthonormal representation, distances.

Vectorised over N lines. Plücker: N = A × U with ‖U‖ = 1 and N · U = 0; ‖N‖ is the distance of
the line to the origin of its frame. Orthonormal (Bartoli and Sturm 2005): the same line with
four parameters to move, no more, so that an optimiser needs no constraint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array, check_shape, freeze_fields

_COINCIDENT = 1e-12         # points nearer than this share of their size give no direction
_THROUGH_ORIGIN_M = 1e-12   # a moment this short is rounding: it has no direction of its own
_MIN_SINE = 1e-9            # lines at infinity are put at 1e9 m, so that all numbers are finite
_PARALLEL_SINE = 1e-8       # below, rounding leaves no common perpendicular


class DegenerateLine(ValueError):
    """Two points that coincide, or are not finite, lie on no one line."""


@dataclass(frozen=True, slots=True)
class PluckerLines:
    """Infinite 3D lines: N = A × U, with ‖U‖ = 1 and N · U = 0."""

    moment: Array        # (N, 3) m
    direction: Array     # (N, 3) unit

    def __post_init__(self) -> None:
        freeze_fields(self, moment=("N", 3), direction=("N", 3))

    def __len__(self) -> int:
        return len(self.moment)


@dataclass(frozen=True, slots=True)
class OrthonormalLines:
    """Infinite 3D lines as SO(3) × SO(2).

    The columns of `rotation` are N/‖N‖, U/‖U‖ and N×U/‖N×U‖. The cosine and sine of `angle_rad`
    are the first column (w₁, w₂) of W, so the distance to the origin is w₁/w₂ = cot(angle):
    π/2 is a line through the origin, 0 and π are at infinity.
    """

    rotation: Array      # (N, 3, 3)
    angle_rad: Array     # (N,)

    def __post_init__(self) -> None:
        freeze_fields(self, rotation=("N", 3, 3), angle_rad=("N",))

    def __len__(self) -> int:
        return len(self.angle_rad)


def plucker_from_points(A: Array, B: Array) -> PluckerLines:
    """The lines from points A (N, 3) towards points B (N, 3), in metres.

    Raises:
        ShapeError: A or B is not (N, 3).
        DegenerateLine: a pair coincides or is not finite. Such pairs hold no line; drop them
            before, so that rows keep their meaning.
    """
    A, B = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    sizes: dict[str, int] = {}
    check_shape("plucker_from_points: A", A, ("N", 3), sizes)
    check_shape("plucker_from_points: B", B, ("N", 3), sizes)
    along = B - A
    length = np.linalg.norm(along, axis=-1)
    size = np.linalg.norm(A, axis=-1) + np.linalg.norm(B, axis=-1)
    bad = ~((length > _COINCIDENT * size) & np.isfinite(length))
    if bad.any():
        raise DegenerateLine(f"plucker_from_points: {np.count_nonzero(bad)} of {len(A)} pairs "
                             f"coincide or are not finite, the first at row {np.argmax(bad)}")
    U = along / length[:, None]
    return PluckerLines(moment=np.cross(A, U), direction=U)


def transform_lines(T_b_a: Array, lines_a: PluckerLines) -> PluckerLines:
    """Move lines from frame a to frame b (SDPL-SLAM eq. 1).

    N_b = R N_a + t × (R U_a), U_b = R U_a.

    Args:
        T_b_a: (4, 4) rigid transform, translation in metres.
        lines_a: N lines, moments in metres, unit directions.
    Raises:
        ShapeError: T_b_a is not (4, 4).
    """
    T = np.asarray(T_b_a, dtype=np.float64)
    check_shape("transform_lines: T_b_a", T, (4, 4))
    R, t = T[:3, :3], T[:3, 3]
    U = lines_a.direction @ R.T
    return PluckerLines(moment=lines_a.moment @ R.T + np.cross(t, U), direction=U)


def _without_component_along(v: Array, unit: Array) -> Array:
    """What of v (N, 3) is perpendicular to unit vectors (N, 3)."""
    return v - np.sum(v * unit, axis=-1, keepdims=True) * unit


def _any_perpendicular(unit: Array) -> Array:
    """Some unit vector (N, 3) perpendicular to each unit vector (N, 3), the same every time."""
    axis = np.eye(3)[np.argmin(np.abs(unit), axis=-1)]
    out = np.cross(unit, axis)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def orthonormal_from_plucker(lines: PluckerLines) -> OrthonormalLines:
    """The orthonormal representation of N Plücker lines.

    A line through the origin has no moment and so no first column of its own: any perpendicular
    to U stands for it, and the line comes back the same.
    """
    scale = np.linalg.norm(lines.direction, axis=-1)
    u2 = lines.direction / scale[:, None]
    N = _without_component_along(lines.moment, u2)
    moment = np.linalg.norm(N, axis=-1)
    has_moment = moment > _THROUGH_ORIGIN_M * scale
    u1 = N / np.where(has_moment, moment, 1.0)[:, None]
    u1 = _without_component_along(u1, u2)   # once more: rounding weighs in a short moment
    u1 = np.where(has_moment[:, None], u1, _any_perpendicular(u2))
    u1 = u1 / np.linalg.norm(u1, axis=-1, keepdims=True)
    return OrthonormalLines(rotation=np.stack([u1, u2, np.cross(u1, u2)], axis=-1),
                            angle_rad=np.arctan2(scale, moment))


def _finite_sine(angle_rad: Array) -> Array:
    """w₂ = sin(angle), kept off 0, where the line would be at infinity."""
    sine = np.sin(angle_rad)
    return np.where(np.abs(sine) < _MIN_SINE, np.copysign(_MIN_SINE, sine), sine)


def plucker_from_orthonormal(lines: OrthonormalLines) -> PluckerLines:
    """N = (w₁/w₂) u₁, U = u₂: moments in metres, unit directions.

    A line further than 1e9 m, for which w₂ → 0, is put at 1e9 m: its numbers stay finite.
    """
    distance = np.cos(lines.angle_rad) / _finite_sine(lines.angle_rad)
    return PluckerLines(moment=distance[:, None] * lines.rotation[..., 0],
                        direction=lines.rotation[..., 1])


def update(lines: OrthonormalLines, delta: Array) -> OrthonormalLines:
    """U_mat ← U_mat Exp(θ), W ← W R(φ), for `delta` (N, 4) = [θ (3), φ] in radians.

    Raises:
        ShapeError: delta is not (N, 4).
    """
    delta = np.asarray(delta, dtype=np.float64)
    check_shape("update: delta", delta, (len(lines), 4))
    return OrthonormalLines(rotation=lines.rotation @ se3.exp_so3(delta[:, :3]),
                            angle_rad=lines.angle_rad + delta[:, 3])


def plucker_jacobian(lines: OrthonormalLines) -> Array:
    """(N, 6, 4): derivative of [N (m), U] with ‖U‖ = 1 by the four parameters of `update`.

    The division by w₂ that keeps ‖U‖ = 1 is in it. Its rank is 4 but for a line through the
    origin, where it is 3: to first order such a line leaves the origin along u₃ only, as polar
    coordinates do at their pole. Where that may happen, damp the step.
    """
    u1, u2, u3 = np.moveaxis(lines.rotation, -1, 0)
    sine = _finite_sine(lines.angle_rad)
    distance = (np.cos(lines.angle_rad) / sine)[:, None]
    J = np.zeros((len(lines), 6, 4))
    J[:, :3, 1], J[:, :3, 2] = -distance * u3, distance * u2
    J[:, :3, 3] = -u1 / (sine * sine)[:, None]
    J[:, 3:, 0], J[:, 3:, 2] = u3, -u1
    return J


def point_line_distance(points: Array, lines: PluckerLines) -> Array:
    """Distances (N,) in metres of points (N, 3), each to its own line: ‖P × U − N‖."""
    points = np.asarray(points, dtype=np.float64)
    check_shape("point_line_distance: points", points, (len(lines), 3))
    return np.asarray(np.linalg.norm(np.cross(points, lines.direction) - lines.moment, axis=-1))


def feet_of_origin(lines: PluckerLines) -> Array:
    """Points (N, 3) of the lines that are nearest to the origin: U × N."""
    return np.cross(lines.direction, lines.moment)


def closest_points_on_line(points: Array, lines: PluckerLines) -> Array:
    """Feet (N, 3) of the perpendiculars from points (N, 3), each on its own line."""
    points = np.asarray(points, dtype=np.float64)
    check_shape("closest_points_on_line: points", points, (len(lines), 3))
    U = lines.direction
    return feet_of_origin(lines) + np.sum(points * U, axis=-1, keepdims=True) * U


def line_line_distance(lines_1: PluckerLines, lines_2: PluckerLines) -> Array:
    """Distances (N,) in metres between infinite lines, row by row.

    Skew lines: |U₁·N₂ + U₂·N₁| / ‖U₁×U₂‖. Parallel lines: ‖U₁ × (N₁ − N₂/s)‖, U₂ = s U₁.
    Both are evaluated from the gap between a point of the first line and its foot on the second,
    so that nothing is lost where the lines are nearly parallel or far from the origin. Below a
    sine of 1e-8 lines count as parallel.

    The value itself jumps there: lines that all but coincide over a room may meet a kilometre
    away. To compare two estimates of one segment, measure from its endpoints' feet instead
    (`closest_points_on_line`, `point_line_distance`).
    """
    check_shape("line_line_distance: lines_2", lines_2.moment, (len(lines_1), 3))
    foot = feet_of_origin(lines_1)
    gap = closest_points_on_line(foot, lines_2) - foot
    common = np.cross(lines_1.direction, lines_2.direction)
    sine = np.linalg.norm(common, axis=-1)
    parallel = sine < _PARALLEL_SINE
    skew = np.abs(np.sum(gap * common, axis=-1)) / np.where(parallel, 1.0, sine)
    return np.where(parallel, np.linalg.norm(gap, axis=-1), skew)
