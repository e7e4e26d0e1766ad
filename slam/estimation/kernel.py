"""The robust kernels of the solver."""

from __future__ import annotations

import numba
import numpy as np


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
