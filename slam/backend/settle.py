"""What a solution tells beside itself: its noise, its misfits, what to hold of its landmarks."""

from __future__ import annotations

import numba
import numpy as np

from slam.backend.linearise import UNSEEN_CHI2
from slam.backend.reduced import invert
from slam.spread import MEDIAN_CHI2_1, MEDIAN_CHI2_2

_MIN_SIGHTINGS = 4            # of a landmark: fewer take the shape of its noise
_NEAR = 8                     # sightings of a landmark whose errors are compared
_MIN_FOR_SCALE = 50           # sightings from which a noise scale may be read


@numba.njit(cache=True)
def noise_ratios(start, r, chi2, whitening, width):  # type: ignore[no-untyped-def]
    """Measured over assumed variance of pixels and of inverse depths; 1 where too few tell.

    A landmark's own place takes up one sighting's worth of its residuals.

    Args:
        r, chi2: weighted whitened residuals (M, R), squared whitened lengths (M,).
        width: of Cauchy's kernel, by which they are weighted.
    """
    uv, rho = np.empty(len(chi2)), np.empty(len(chi2) * (r.shape[1] - 2))
    found = deep = 0
    for p in range(len(start) - 1):
        count = start[p + 1] - start[p]
        if count < _MIN_SIGHTINGS:
            continue
        for i in range(start[p], start[p + 1]):
            if not (np.isfinite(chi2[i]) and whitening[i, 0] > 0.0):
                continue
            scale = count / (count - 1.0) * (1.0 + chi2[i] / (width * width))
            uv[found] = (r[i, 0] ** 2 + r[i, 1] ** 2) * scale
            found += 1
            for k in range(2, r.shape[1]):
                if whitening[i, k + 1] > 0.0:
                    rho[deep] = r[i, k] ** 2 * scale
                    deep += 1
    ratio_uv = ratio_rho = 1.0
    if found >= _MIN_FOR_SCALE:
        ratio_uv = np.median(uv[:found]) / MEDIAN_CHI2_2
        if deep >= _MIN_FOR_SCALE:
            ratio_rho = np.median(rho[:deep]) / MEDIAN_CHI2_1
    return ratio_uv, ratio_rho


@numba.njit(cache=True)
def likeness(start, r):  # type: ignore[no-untyped-def]
    """Correlation of the pixel errors of one landmark's sightings; 0 where too few tell.

    Over sightings up to 7 apart. That a landmark's place takes up the mean of its n residuals makes
    them correlate by −1/n: so much is added.

    Args:
        r: (M, R) whitened residuals; the first two are the pixels'.
    """
    together, alone, count = 0.0, 0.0, 0
    for p in range(len(start) - 1):
        first, last = start[p], start[p + 1]
        n = last - first
        if n < _MIN_SIGHTINGS:
            continue
        square = 0.0
        for i in range(first, last):
            square += r[i, 0] ** 2 + r[i, 1] ** 2
        square /= n - 1.0
        for i in range(first, last):
            for j in range(i + 1, min(i + _NEAR, last)):
                together += r[i, 0] * r[j, 0] + r[i, 1] * r[j, 1] + square / n
                alone += square
                count += 1
    return together / alone if count >= _MIN_FOR_SCALE and alone > 0.0 else 0.0


@numba.njit(cache=True)
def misfits(start, chi2, limit):  # type: ignore[no-untyped-def]
    """(P,) bool: landmarks most of whose chi2 are above a limit."""
    wrong = np.zeros(len(start) - 1, np.bool_)
    for p in range(len(start) - 1):
        bad = 0
        for i in range(start[p], start[p + 1]):
            bad += chi2[i] > limit
        wrong[p] = 2 * bad > start[p + 1] - start[p]
    return wrong


@numba.njit(cache=True)
def drop_misfits(start, chi2, limit, width, whitening, r, J, V):  # type: ignore[no-untyped-def]
    """Set to 0 all that is known of landmarks most of whose chi2 are above a limit.

    Returns:
        what they cost, by Cauchy's kernel of this width.
    """
    cost, wrong = 0.0, misfits(start, chi2, limit)
    for p in range(len(start) - 1):
        if wrong[p]:
            for i in range(start[p], start[p + 1]):
                cost += width * width * np.log1p(min(chi2[i], UNSEEN_CHI2) / (width * width))
                whitening[i], r[i], J[i], V[i], chi2[i] = 0.0, 0.0, 0.0, 0.0, 0.0
    return cost


@numba.njit(cache=True)
def condense(index, landmark, r, V, information, pull):  # type: ignore[no-untyped-def]
    """Add sightings, of poses that are known, to information (P, D, D) and its pull (P, D).

    Returns:
        (P, D) the step of each landmark to where the information would have it.
    """
    for i in index:
        p = landmark[i]
        for row in range(V.shape[1]):
            for a in range(V.shape[2]):
                pull[p, a] += V[i, row, a] * r[i, row]
                for c in range(V.shape[2]):
                    information[p, a, c] += V[i, row, a] * V[i, row, c]
    size = pull.shape[1]
    step, C, room, inverse = (np.zeros_like(pull), np.empty((size, size)),
                              np.empty((size, size)), np.empty((size, size)))
    for p in range(len(pull)):
        trace = 0.0
        for a in range(size):
            trace += information[p, a, a]
        C[:] = information[p]
        for a in range(size):
            C[a, a] += 1e-9 * trace + 1e-12
        invert(C, room, inverse)
        for a in range(size):
            for c in range(size):
                step[p, a] -= inverse[a, c] * pull[p, c]
    return step
