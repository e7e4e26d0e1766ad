"""Sightings at a point of linearisation, whitened and weighted by Cauchy's kernel: compiled loops."""

from __future__ import annotations

import numba
import numpy as np

from slam.factors import landmark_row
from slam.line_sightings import line_sighting_row

_UNSEEN_CHI2 = 1e6            # what a landmark costs that its pose cannot see


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
    r, J, V = np.empty(3), np.zeros((3, 6)), np.empty((3, 3))
    for i in range(len(pose)):
        seen = landmark_row(T[pose[i]], xyz[landmark[i]], uv[i], rho[i], camera, r, J, V)
        cost += _weigh(seen, r, J, V, whitening[i], width, rw[i], Jw[i], Vw[i], chi2, i)
    return cost, chi2


@numba.njit(cache=True)
def linearise_lines(T, lines, pose, landmark, ends, rho, whitening,  # type: ignore[no-untyped-def]
                    camera, width, rw, Jw, Vw):
    """As `linearise`, for lines: (M, 4), (M, 4, 6), (M, 4, 4).

    Args:
        whitening: (M, 5): L⁻¹ of the two ends' distances, 1/σ of both inverse depths.
    """
    cost, chi2 = 0.0, np.empty(len(pose))
    r, J, V = np.empty(4), np.zeros((4, 6)), np.empty((4, 4))
    by = np.empty((6, 11))
    for i in range(len(pose)):
        seen = line_sighting_row(T[pose[i]], lines[landmark[i]], ends[i], rho[i], camera, r, J, V,
                                 by)
        cost += _weigh(seen, r, J, V, whitening[i], width, rw[i], Jw[i], Vw[i], chi2, i)
    return cost, chi2


@numba.njit(cache=True)
def _weigh(seen, r, J, V, whitening, width, rw, Jw, Vw, chi2, i):  # type: ignore[no-untyped-def]
    """Fill sighting i: whitened, and weighted by Cauchy's kernel; its cost."""
    if not seen:
        rw[:], Jw[:], Vw[:] = 0.0, 0.0, 0.0
        chi2[i] = np.inf
        return width * width * np.log1p(_UNSEEN_CHI2 / (width * width))
    l00, l10, l11 = whitening[0], whitening[1], whitening[2]
    r0, r1 = l00 * r[0], l10 * r[0] + l11 * r[1]
    total = r0 * r0 + r1 * r1
    for k in range(2, len(r)):
        rw[k] = whitening[k + 1] * r[k]
        total += rw[k] * rw[k]
    chi2[i] = total
    weight = np.sqrt(1.0 / (1.0 + total / (width * width)))
    rw[0], rw[1] = weight * r0, weight * r1
    l00, l10, l11 = weight * l00, weight * l10, weight * l11
    for c in range(J.shape[1]):
        Jw[0, c], Jw[1, c] = l00 * J[0, c], l10 * J[0, c] + l11 * J[1, c]
    for c in range(V.shape[1]):
        Vw[0, c], Vw[1, c] = l00 * V[0, c], l10 * V[0, c] + l11 * V[1, c]
    for k in range(2, len(r)):
        scale = weight * whitening[k + 1]
        rw[k] *= weight
        for c in range(J.shape[1]):
            Jw[k, c] = scale * J[k, c]
        for c in range(V.shape[1]):
            Vw[k, c] = scale * V[k, c]
    return width * width * np.log1p(total / (width * width))


@numba.njit(cache=True)
def condense(index, landmark, r, V, information, pull):  # type: ignore[no-untyped-def]
    """Add sightings, of poses that are known, to information (P, D, D) and pull (P, D)."""
    for i in index:
        p = landmark[i]
        for row in range(V.shape[1]):
            for a in range(V.shape[2]):
                pull[p, a] += V[i, row, a] * r[i, row]
                for c in range(V.shape[2]):
                    information[p, a, c] += V[i, row, a] * V[i, row, c]
