"""The image cut into tiles, over which noise and errors are measured apart."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array
from slam.types import Intrinsics


def tiles(uv_px: Array, group: Array, camera: Intrinsics, shape: tuple[int, int]) -> Array:
    """Tile (N,) of each feature: by its place in the image cut into rows and columns, or, after
    those, by its object."""
    rows, columns = shape
    row = np.clip(uv_px[:, 1] * rows / camera.height, 0, rows - 1).astype(np.int64)
    column = np.clip(uv_px[:, 0] * columns / camera.width, 0, columns - 1).astype(np.int64)
    return np.where(group == 0, row * columns + column, rows * columns + group - 1)
