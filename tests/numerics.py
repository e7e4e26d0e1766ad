"""Derivatives by central differences, to hold analytic ones against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slam.geometry.arrays import Array


def numerical_jacobian(function: Callable[[Array], Array], at: Array | int = 6,
                       step: float = 1e-6) -> Array:
    """Derivative (*output shape, D) of `function` by its vector argument (D,).

    Args:
        function: takes a vector (D,), returns an array of any shape.
        at: where; a number D stands for D zeros, as for a tangent vector.
        step: half the distance of the two values; 1e-6 suits values and scales near 1.
    """
    x = np.zeros(at) if isinstance(at, int) else np.asarray(at, dtype=np.float64)
    columns = [(np.asarray(function(x + step * e)) - np.asarray(function(x - step * e)))
               / (2.0 * step) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)
