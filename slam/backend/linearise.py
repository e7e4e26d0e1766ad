"""Sightings at a point of linearisation, whitened and weighted by Cauchy's kernel; compiled."""

from __future__ import annotations

import numba
import numpy as np

from slam.factors import landmark_row
from slam.line_sightings import line_distance_row, line_sighting_row

UNSEEN_CHI2 = 1e6            # what a landmark costs that its pose cannot see


@numba.njit(cache=True)
def linearise(T, xyz, pose, landmark, uv, rho, whitening, camera, width,  # type: ignore[no-untyped-def]
              rw, Jw, Vw):
    """Fill the weighted whitened residuals (M, 3), derivatives (M, 3, 6), (M, 3, 3).

    Args:
        whitening: (M, 4): the lower triangle of L⁻¹ (uu, vu, vv) of the pixel, 1/σ of ρ.
        width: of Cauchy's kernel.
    Returns:
        the objective; chi2 (M,), each sighting's squared whitened length, inf where unseen.
    """
    cost, chi2 = 0.0, np.empty(len(pose))
    r, J, V = np.zeros(3), np.zeros((3, 6)), np.zeros((3, 3))
    for i in range(len(pose)):
        if not landmark_row(T[pose[i]], xyz[landmark[i]], uv[i], rho[i], camera, r, J, V):
            cost += _unseen(i, width, rw, Jw, Vw, chi2)
            continue
        cost += _weigh(i, 3, 3, r, J, V, whitening, width, rw, Jw, Vw, chi2)
    return cost, chi2


@numba.njit(cache=True)
def linearise_lines(T, lines, pose, landmark, ends, rho, whitening,  # type: ignore[no-untyped-def]
                    camera, width, rw, Jw, Vw):
    """As `linearise`, for lines: (M, 4), (M, 4, 6), (M, 4, 4).

    Args:
        whitening: (M, 5): L⁻¹ of the two ends' distances, 1/σ of both inverse depths.
    """
    cost, chi2 = 0.0, np.empty(len(pose))
    r, J, V = np.zeros(4), np.zeros((4, 6)), np.zeros((4, 4))
    by = np.empty((6, 11))
    for i in range(len(pose)):
        if not line_sighting_row(T[pose[i]], lines[landmark[i]], ends[i], rho[i], camera, r, J, V,
                                 by):
            cost += _unseen(i, width, rw, Jw, Vw, chi2)
            continue
        cost += _weigh(i, 4, 4, r, J, V, whitening, width, rw, Jw, Vw, chi2)
    return cost, chi2


@numba.njit(cache=True)
def linearise_line_distances(T, lines, pose, landmark, ends, whitening,  # type: ignore[no-untyped-def]
                             width, rw, Jw, Vw):
    """As `linearise`, for lines by eq. (5) as printed: (M, 2), (M, 2, 6), (M, 2, 4).

    Args:
        ends: (M, 2, 3) in the camera, m.
        whitening: (M, 3): L⁻¹ of the two distances.
    """
    cost, chi2 = 0.0, np.empty(len(pose))
    r, J, V = np.zeros(2), np.zeros((2, 6)), np.zeros((2, 4))
    by = np.empty((6, 11))
    for i in range(len(pose)):
        line_distance_row(T[pose[i]], lines[landmark[i]], ends[i], r, J, V, by)
        cost += _weigh(i, 2, 4, r, J, V, whitening, width, rw, Jw, Vw, chi2)
    return cost, chi2


@numba.njit(cache=True, inline="always")
def _weigh(i, rows, size, r, J, V, whitening, width,  # type: ignore[no-untyped-def]
           rw, Jw, Vw, chi2):
    """Fill sighting i, of `rows` residuals and `size` parameters: whitened, and weighted by
    Cauchy's kernel; its cost. A function apart would cost more than what it does.
    """
    l00, l10, l11 = whitening[i, 0], whitening[i, 1], whitening[i, 2]
    r0, r1 = l00 * r[0], l10 * r[0] + l11 * r[1]
    total = r0 * r0 + r1 * r1
    for k in range(2, rows):
        own = whitening[i, k + 1] * r[k]
        total += own * own
    chi2[i] = total
    weight = np.sqrt(1.0 / (1.0 + total / (width * width)))
    rw[i, 0], rw[i, 1] = weight * r0, weight * r1
    l00, l10, l11 = weight * l00, weight * l10, weight * l11
    for c in range(6):
        Jw[i, 0, c], Jw[i, 1, c] = l00 * J[0, c], l10 * J[0, c] + l11 * J[1, c]
    for c in range(size):
        Vw[i, 0, c], Vw[i, 1, c] = l00 * V[0, c], l10 * V[0, c] + l11 * V[1, c]
    for k in range(2, rows):
        scale = weight * whitening[i, k + 1]
        rw[i, k] = scale * r[k]
        for c in range(6):
            Jw[i, k, c] = scale * J[k, c]
        for c in range(size):
            Vw[i, k, c] = scale * V[k, c]
    return width * width * np.log1p(total / (width * width))


@numba.njit(cache=True)
def _unseen(i, width, rw, Jw, Vw, chi2):  # type: ignore[no-untyped-def]
    """Fill sighting i of what its pose cannot see; its cost."""
    rw[i], Jw[i], Vw[i], chi2[i] = 0.0, 0.0, 0.0, np.inf
    return width * width * np.log1p(UNSEEN_CHI2 / (width * width))


@numba.njit(cache=True)
def whitening(covariance, rho_sigma):  # type: ignore[no-untyped-def]
    """(M, 3 + K): L⁻¹ (00, 10, 11) of covariances (M, 2, 2), then 1/σ of (M, K)."""
    out = np.empty((len(covariance), 3 + rho_sigma.shape[1]))
    for i in range(len(covariance)):
        l00 = np.sqrt(covariance[i, 0, 0])
        l10 = covariance[i, 1, 0] / l00
        l11 = np.sqrt(max(covariance[i, 1, 1] - l10 * l10, 1e-12))
        out[i, 0], out[i, 1], out[i, 2] = 1.0 / l00, -l10 / (l00 * l11), 1.0 / l11
        for k in range(rho_sigma.shape[1]):
            out[i, 3 + k] = 1.0 / rho_sigma[i, k]
    return out
