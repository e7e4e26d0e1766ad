"""Segments in the image."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

_SHORTEST_PX = 1e-9      # of a segment with a direction


def unit_normals(ends_px: Array) -> Array:
    """(N, 2) unit normals, a quarter turn from the way from start to end of segments (N, 2, 2).

    Of a segment without length: zero.
    """
    along = ends_px[:, 1] - ends_px[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True),
                                          _SHORTEST_PX))
