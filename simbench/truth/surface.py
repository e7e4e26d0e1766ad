"""The surface that a depth image samples, as small planes between its pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simbench.types import FrameTruth
from slam.geometry.arrays import Array

# Depth images are exact to 1e-4 m or 1e-4 of the distance; twice that is no step.
TOLERANCE_M = 2e-4
TOLERANCE_RELATIVE = 2e-4
_NO_PART = -2


class Surface(NamedTuple):
    """Inverse depth, which is affine in the pixel on a plane.

    A cell is a square of four neighbouring pixels and bears the index of its first corner.
    """

    truth: FrameTruth
    inverse_depth: Array   # (H * W,) float32; 0 where nothing is seen
    cell_part: Array       # (H * W,) int32 part that the four show as one plane, else -2


def surface_of(truth: FrameTruth) -> Surface:
    """The surface seen in a frame."""
    part, depth = truth.part_id, truth.depth_m
    inverse = np.divide(np.float32(1.0), depth, where=depth > 0.0, out=np.zeros_like(depth))
    corner = part[:-1, :-1]
    alike = (corner == part[:-1, 1:]) & (corner == part[1:, :-1]) & (corner == part[1:, 1:])
    bend = inverse[:-1, :-1] - inverse[:-1, 1:]
    bend -= inverse[1:, :-1]
    bend += inverse[1:, 1:]
    alike &= np.abs(bend) <= TOLERANCE_RELATIVE * inverse[:-1, :-1]
    cell_part = np.full(part.shape, _NO_PART, np.int32)
    np.copyto(cell_part[:-1, :-1], corner, where=alike)
    return Surface(truth, inverse.ravel(), cell_part.ravel())
