"""The surface that a depth image samples, as small planes between its pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simbench.types import FrameTruth
from slam.geometry.arrays import Array

# Depth images are exact to 1e-4 m or 1e-4 of the distance; twice that is no step.
TOLERANCE_M = 2e-4
TOLERANCE_RELATIVE = 2e-4
_STRAIGHT = 2e-5   # rounding of three inverse depths on one plane stays below this share of them
_NO_PART = -2


class Surface(NamedTuple):
    """Inverse depth, which is affine in the pixel on a plane.

    A cell is a square of four neighbouring pixels and bears the index of its first corner.
    """

    truth: FrameTruth
    inverse_depth: Array   # (H * W,) float32; 0 where nothing is seen
    cell_part: Array       # (H * W,) int32 part that the four show as one plane, else -2

    @property
    def width(self) -> int:
        return int(self.truth.depth_m.shape[1])


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


def in_a_cell(surface: Surface, u: Array, v: Array) -> Array:
    """True where a pixel position lies between four pixels; the image reaches half a pixel more."""
    height, width = surface.truth.depth_m.shape
    return (np.minimum(u, v) >= 0.0) & (u < width - 1) & (v < height - 1)


def plane_through(surface: Surface, pixel: Array) -> tuple[Array, Array]:
    """The plane on which each pixel's surface lies, where two more pixels beside it confirm it.

    Args:
        pixel: (N,) int, flat indices.
    Returns:
        (N, 3) π with inverse depth π · (u, v, 1); (N,) bool, False where there is no such plane.
    """
    v, u = np.divmod(pixel, surface.width)
    height, width = surface.truth.depth_m.shape
    gu, known_u = _gradient(surface, pixel, u, width, 1)
    gv, known_v = _gradient(surface, pixel, v, height, width)
    constant = surface.inverse_depth[pixel] - gu * u - gv * v
    return np.stack([gu, gv, constant], axis=-1), known_u & known_v


def _gradient(surface: Surface, pixel: Array, position: Array, size: int, stride: int
              ) -> tuple[Array, Array]:
    """(N,) change of inverse depth per pixel along one axis, and whether it is known.

    It is taken from the next pixel on the side where the one after it goes on straight.
    """
    w, part = surface.inverse_depth, surface.truth.part_id.ravel()
    gradient, known = np.zeros(len(pixel)), np.zeros(len(pixel), bool)
    for side in (1, -1):
        reach = position + 2 * side
        fits = ~known & (reach >= 0) & (reach < size)
        one = np.where(fits, pixel + side * stride, pixel)
        two = np.where(fits, pixel + 2 * side * stride, pixel)
        fits &= (part[one] == part[pixel]) & (part[two] == part[pixel])
        step = w[one].astype(np.float64) - w[pixel]
        fits &= np.abs((w[two] - w[one]) - step) <= _STRAIGHT * w[pixel]
        gradient[fits] = side * step[fits]
        known |= fits
    return gradient, known
