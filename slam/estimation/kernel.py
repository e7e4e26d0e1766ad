"""The robust kernels of the solver."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from slam.geometry.arrays import Array


@numba.njit(cache=True, nogil=True)
def robust(chi2, huber, width):  # type: ignore[no-untyped-def]
    """Weight and loss of a squared whitened length: Huber's kernel, or Cauchy's."""
    if not np.isfinite(chi2):
        return 0.0, 1e12
    if huber:
        if chi2 <= width * width:
            return 1.0, chi2
        chi = np.sqrt(chi2)
        return width / chi, 2.0 * width * chi - width * width
    ratio = chi2 / (width * width)
    return 1.0 / (1.0 + ratio), width * width * np.log1p(ratio)


class KernelEffect(NamedTuple):
    """What a kernel leaves of each motion's information, by its residuals."""

    efficiency: Array     # (G,) true over weighted information: what Σ w JᵀJ must be multiplied by
    score: Array          # (G,) variance of the scores w Jᵀr over Σ w JᵀJ


def kernel_effect(chi2: Array, rows: Array, group: Array, groups: int, huber: bool,
                  width: float) -> KernelEffect:
    """Efficiency of a robust estimate, and the variance of its scores (Huber 1973).

    A robust estimate's covariance is b/a² (Σ JᵀJ)⁻¹, with a the mean derivative of the influence
    ψ = w r and b the mean of ψ² over the whitened residuals; Σ w JᵀJ alone claims 1/mean(w). With
    Cauchy's kernel and Gaussian residuals that is a fifth too much variance; with residuals larger
    than was assumed it is too little.

    Args:
        chi2: (N,) squared whitened lengths of the residuals, all groups'.
        rows: (N,) how many numbers each residual has.
        group: (N,) which of the G motions each belongs to.
    """
    known = np.isfinite(chi2)
    chi2, rows, group = chi2[known], rows[known], group[known]
    chi = np.sqrt(np.maximum(chi2, 1e-300))
    if huber:
        inner = chi <= width
        weight = np.where(inner, 1.0, width / chi)
        slope = np.where(inner, 1.0, weight * (1.0 - 1.0 / rows))
    else:
        weight = 1.0 / (1.0 + chi2 / width**2)
        slope = weight - 2.0 * weight**2 * chi2 / (width**2 * rows)
    count = np.bincount(group, rows, groups)
    mean_weight = np.bincount(group, rows * weight, groups) / np.maximum(count, 1.0)
    a = np.bincount(group, rows * slope, groups) / np.maximum(count, 1.0)
    freedom = np.maximum(count - 6.0, 1.0)
    b = np.bincount(group, weight**2 * chi2, groups) / freedom
    usable = (count > 12.0) & (a > 0.0) & (b > 0.0)
    score = np.where(usable, b / np.where(usable, mean_weight, 1.0), 1.0)
    factor = a**2 / np.where(usable, b * mean_weight, 1.0)
    return KernelEffect(np.where(usable, factor, 1.0), score)
