"""The back-end's equations of lines, (5) and (6), in the paper's form and well conditioned.

The paper's norms have no derivative where they vanish, which is where an optimiser takes them, and
1 − cos has none to speak of. The well-conditioned forms keep the vectors whose lengths these are,
on two directions across the line that are held fixed while an equation is linearised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam.geometry import line, se3
from slam.geometry.arrays import Array
from slam.geometry.line import OrthonormalLines, PluckerLines

ZERO_M = 1e-12         # a distance below this is rounding; its derivative is taken as 0
_PARALLEL_SINE = 1e-8  # as in slam.geometry.line


class LineTerms(NamedTuple):
    r: Array           # (N, D)
    J_pose: Array      # (N, D, 6)
    J_line: Array      # (N, D, 4)


class LineMotionTerms(NamedTuple):
    r: Array           # (N, D)
    J_H: Array         # (N, D, 6)
    J_before: Array    # (N, D, 4) with respect to the line at k-1
    J_now: Array       # (N, D, 4) with respect to the line at k


def across(direction: Array) -> Array:
    """Two unit vectors (N, 2, 3) perpendicular to each direction (N, 3) and to each other."""
    least = np.argmin(np.abs(direction), axis=1)
    first = np.cross(direction, np.eye(3)[least])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def in_camera(T_body_camera: Array, lines: OrthonormalLines) -> tuple[PluckerLines, Array, Array]:
    """Lines of a body as the camera has them.

    Returns:
        the lines, ∂[N, U]/∂ξ (N, 6, 6), ∂[N, U]/∂δ (N, 6, 4).
    """
    moved, J = _moved(se3.inverse(T_body_camera), lines)
    N, U = se3.skew(moved.moment), se3.skew(moved.direction)
    J_pose = np.zeros((len(lines), 6, 6))
    J_pose[:, :3, :3], J_pose[:, :3, 3:], J_pose[:, 3:, :3] = N, U, U
    return moved, J_pose, J


def _moved(T: Array, lines: OrthonormalLines) -> tuple[PluckerLines, Array]:
    """Lines moved by transforms (N, 4, 4), each by its own, and ∂[N, U]/∂δ (N, 6, 4)."""
    plucker = line.plucker_from_orthonormal(lines)
    R, t = T[:, :3, :3], T[:, :3, 3]
    motion = np.zeros((len(lines), 6, 6))
    motion[:, :3, :3] = motion[:, 3:, 3:] = R
    motion[:, :3, 3:] = se3.skew(t) @ R
    both = np.concatenate([plucker.moment, plucker.direction], axis=1)
    out = np.einsum("nij,nj->ni", motion, both)
    return PluckerLines(out[:, :3], out[:, 3:]), motion @ line.plucker_jacobian(lines)


def line_measurement(T_body_camera: Array, lines: OrthonormalLines, endpoints: Array,
                     basis: Array | None = None) -> LineTerms:
    """3D line measurement, eq. (5), well conditioned: A × U − N and B × U − N across the line.

    Args:
        T_body_camera: (N, 4, 4).
        endpoints: (N, 2, 3) observed A and B in the camera, m.
        basis: (N, 2, 3) directions across the line, from `across`; None: from the line itself.
    Returns:
        four rows: A on both directions, then B, in metres. Their lengths are eq. (5)'s.
    """
    e, J_pose, J_line = _endpoint_gaps(T_body_camera, lines, endpoints)
    if basis is None:
        basis = across(in_camera(T_body_camera, lines)[0].direction)
    n = len(lines)
    return LineTerms(np.einsum("nbi,nei->neb", basis, e).reshape(n, 4),
                     np.einsum("nbi,neij->nebj", basis, J_pose).reshape(n, 4, 6),
                     np.einsum("nbi,neij->nebj", basis, J_line).reshape(n, 4, 4))


def line_measurement_covariance(direction: Array, basis: Array, covariance: Array) -> Array:
    """(N, 2, 2, 2) covariances of the rows of A and of B, from those of the endpoints.

    Args:
        direction: (N, 3) of the line in the camera.
        basis: (N, 2, 3) as given to `line_measurement`.
        covariance: (N, 2, 3, 3) of the endpoints A and B in the camera, m².
    """
    projection = (-basis @ se3.skew(direction))[:, None]
    return np.asarray(projection @ covariance @ np.swapaxes(projection, -1, -2))


def line_measurement_paper(T_body_camera: Array, lines: OrthonormalLines, endpoints: Array
                           ) -> LineTerms:
    """3D line measurement, eq. (5), as printed: [‖A × U − N‖, ‖B × U − N‖], in metres."""
    e, J_pose, J_line = _endpoint_gaps(T_body_camera, lines, endpoints)
    length = np.linalg.norm(e, axis=2)
    unit = np.where(length[..., None] > ZERO_M, e, 0.0) / np.maximum(length, ZERO_M)[..., None]
    return LineTerms(length, np.einsum("nei,neij->nej", unit, J_pose),
                     np.einsum("nei,neij->nej", unit, J_line))


def _endpoint_gaps(T_body_camera: Array, lines: OrthonormalLines, endpoints: Array
                   ) -> tuple[Array, Array, Array]:
    """P × U − N (N, 2, 3) of both endpoints, with derivatives (N, 2, 3, 6) and (N, 2, 3, 4)."""
    seen, J_pose, J_line = in_camera(T_body_camera, lines)
    e = np.cross(endpoints, seen.direction[:, None]) - seen.moment[:, None]
    outer = np.concatenate([np.broadcast_to(-np.eye(3), (*endpoints.shape[:2], 3, 3)),
                            se3.skew(endpoints)], axis=-1)
    return e, outer @ J_pose[:, None], outer @ J_line[:, None]


def line_motion(H: Array, before: OrthonormalLines, now: OrthonormalLines, endpoints: Array,
                basis: Array | None = None) -> LineMotionTerms:
    """Line motion, eq. (6), well conditioned.

    The feet of the two observed endpoints on the line at k−1 are moved by H; how far they then
    are from the line at k, on two directions across it.

    Args:
        H: (N, 4, 4) motions in the frame of the lines.
        endpoints: (N, 2, 3) observed at k−1, in the frame of the lines, m.
        basis: (N, 2, 3) directions across the line at k; None: from the line itself.
    Returns:
        four rows, m.
    """
    n = len(now)
    first, last = line.plucker_from_orthonormal(before), line.plucker_from_orthonormal(now)
    basis = across(last.direction) if basis is None else basis
    U, N = first.direction[:, None], first.moment[:, None]
    along = np.sum(endpoints * U, axis=2, keepdims=True)
    feet = np.cross(U, N) + along * U
    d_feet = np.concatenate([
        np.broadcast_to(se3.skew(U), (n, 2, 3, 3)),
        -se3.skew(N) + U[..., :, None] * endpoints[..., None, :] + along[..., None] * np.eye(3),
    ], axis=-1) @ line.plucker_jacobian(before)[:, None]
    R = H[:, None, :3, :3]
    moved = (R @ feet[..., None])[..., 0] + H[:, None, :3, 3]
    e = np.cross(moved, last.direction[:, None]) - last.moment[:, None]
    d_moved = -se3.skew(last.direction)[:, None]                       # ∂e/∂moved
    J_H = d_moved @ np.concatenate([-R @ se3.skew(feet), np.broadcast_to(R, (n, 2, 3, 3))], -1)
    J_before = d_moved @ R @ d_feet
    outer = np.concatenate([np.broadcast_to(-np.eye(3), (n, 2, 3, 3)), se3.skew(moved)], axis=-1)
    J_now = outer @ line.plucker_jacobian(now)[:, None]
    return LineMotionTerms(*(np.einsum("nbi,nei...->neb...", basis, part).reshape(
        n, 4, *part.shape[3:]) for part in (e, J_H, J_before, J_now)))


def line_motion_paper(H: Array, before: OrthonormalLines, now: OrthonormalLines
                      ) -> LineMotionTerms:
    """Line motion, eq. (6), as printed: [dist(ℒ_k, H ℒ_{k−1}), 1 − U_k · U_k^H].

    The first row jumps where the lines become parallel, which is where the solution lies; both
    rows have no gradient at the solution.
    """
    moved, J_before = _moved(H, before)
    last, J_now = line.plucker_from_orthonormal(now), line.plucker_jacobian(now)
    plucker = line.plucker_from_orthonormal(before)
    J_motion = _motion_jacobian(H, plucker)
    r_d, d_now, d_moved = _distance(last, moved)
    r_c = 1.0 - np.sum(last.direction * moved.direction, axis=1)
    zero = np.zeros((len(now), 3))
    by_now = np.stack([d_now, np.concatenate([zero, -moved.direction], axis=1)], axis=1)
    by_moved = np.stack([d_moved, np.concatenate([zero, -last.direction], axis=1)], axis=1)
    return LineMotionTerms(np.stack([r_d, r_c], axis=1), by_moved @ J_motion,
                           by_moved @ J_before, by_now @ J_now)


def _motion_jacobian(H: Array, lines: PluckerLines) -> Array:
    """∂[N, U] of H Exp(ξ) ℒ by ξ (N, 6, 6)."""
    R, t = H[:, :3, :3], se3.skew(H[:, :3, 3])
    N, U = se3.skew(lines.moment), se3.skew(lines.direction)
    J = np.zeros((len(H), 6, 6))
    J[:, :3, :3] = -R @ N - t @ R @ U
    J[:, :3, 3:] = -R @ U
    J[:, 3:, :3] = -R @ U
    return J


def _distance(a: PluckerLines, b: PluckerLines) -> tuple[Array, Array, Array]:
    """Distance (N,) of lines and its derivatives (N, 6) by [N, U] of a and of b."""
    cross = np.cross(a.direction, b.direction)
    sine = np.linalg.norm(cross, axis=1)
    parallel = sine < _PARALLEL_SINE
    safe = np.where(parallel, 1.0, sine)
    mutual = np.sum(a.direction * b.moment + b.direction * a.moment, axis=1)
    sign = np.sign(mutual)
    # Skew: |mutual| / sine, by the quotient rule; ∂ sine/∂U_a = U_b × (U_a × U_b) / sine.
    by_sine = (np.abs(mutual) / safe**3)[:, None]
    scale = (sign / safe)[:, None]
    skew_a = np.concatenate([scale * b.direction, scale * b.moment
                             - by_sine * np.cross(b.direction, cross)], axis=1)
    skew_b = np.concatenate([scale * a.direction, scale * a.moment
                             - by_sine * np.cross(cross, a.direction)], axis=1)
    # Parallel: ‖U_a × (N_a − N_b / s)‖ with U_b = s U_a.
    s = np.where(np.sum(a.direction * b.direction, axis=1) < 0, -1.0, 1.0)[:, None]
    gap = a.moment - s * b.moment
    vector = np.cross(a.direction, gap)
    length = np.linalg.norm(vector, axis=1)
    unit = np.where(length[:, None] > ZERO_M, vector, 0.0) / np.maximum(length, ZERO_M)[:, None]
    by_gap = np.cross(unit, a.direction)
    flat_a = np.concatenate([by_gap, np.cross(gap, unit)], axis=1)
    flat_b = np.concatenate([-s * by_gap, np.zeros_like(gap)], axis=1)
    chosen = parallel[:, None]
    return (np.where(parallel, length, np.abs(mutual) / safe), np.where(chosen, flat_a, skew_a),
            np.where(chosen, flat_b, skew_b))
