"""Standard deviations of noise from medians of what it leaves: a few far off do not count."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

MEDIAN_CHI2_1 = 0.4549       # of χ² with one degree of freedom
MEDIAN_CHI2_2 = float(2.0 * np.log(2.0))     # with two: Rayleigh's median is σ √(2 ln 2)


def sigma_of_distances(distance: Array) -> float:
    """σ of Gaussian noise from its amounts |x| (N,), in one direction: 1.4826 times the median."""
    return float(np.median(np.abs(distance)) / np.sqrt(MEDIAN_CHI2_1))


def sigma_of_lengths(length: Array) -> float:
    """σ of Gaussian noise, equal in two directions, from its lengths (N,): 0.849 of the median."""
    return float(np.median(length) / np.sqrt(MEDIAN_CHI2_2))
