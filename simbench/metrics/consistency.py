"""Do the covariances that a system states match its errors?"""

from __future__ import annotations

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array


def nees(T_estimated: Array, T_true: Array, covariance: Array) -> Array:
    """(N,) εᵀ P⁻¹ ε with ε = Log(T̂⁻¹ T); 6 on average where the covariances are right.

    Args:
        T_estimated, T_true: (N, 4, 4); covariance: (N, 6, 6) of T̂ Exp(ξ), ξ = [ω, v].
    """
    epsilon = se3.log(se3.inverse(T_estimated) @ T_true)
    weighted = np.linalg.solve(covariance, epsilon[..., None])[..., 0]
    return np.asarray(np.sum(epsilon * weighted, axis=-1))
