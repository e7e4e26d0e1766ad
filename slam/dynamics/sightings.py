"""What one frame shows of each mask: where it is, how large, in which colours."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numba
import numpy as np

from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.types import Intrinsics

_STEP_PX = 3      # a mask is sampled at every third pixel
_LEVELS = 4       # of each colour channel
_PART = 4.0       # a part of a thing shows at most so much more of a colour than the whole


@dataclass(frozen=True, slots=True)
class MaskSightings:
    """The masks of one frame that have depth, one row each."""

    label: Array           # (M,) int64
    place_world: Array     # (M, 3) m: the middle of what is visible
    extent_m: Array        # (M,) root of the visible area
    cut_off: Array         # (M,) bool: the image's border cuts the mask
    colours: Array         # (M, 64) shares of the colours; sums are 1

    def __post_init__(self) -> None:
        freeze_fields(self, label=("M",), place_world=("M", 3), extent_m=("M",), cut_off=("M",),
                      colours=("M", _LEVELS**3))

    def __len__(self) -> int:
        return len(self.label)

    def without(self, labels: Collection[int]) -> MaskSightings:
        """Those of other labels."""
        kept = ~np.isin(self.label, list(labels))
        return MaskSightings(*(getattr(self, name)[kept] for name in self.__slots__))


def sightings(labels: Array, label_index: Array, rho: Array, rgb: Array, T_world_camera: Array,
              camera: Intrinsics) -> MaskSightings:
    """Place, size and colours of every mask with depth on it.

    Args:
        labels, label_index: (n + 1,) and (H, W) uint8, [0] is the background; as of Observation.
        rho: (H, W) 1/m, 0 = unknown.
        rgb: (H, W, 3) uint8.
        T_world_camera: (4, 4) where the frame was taken.
    """
    count = len(labels)
    index = label_index[::_STEP_PX, ::_STEP_PX]
    row, column = np.nonzero((index > 0) & (index < count))
    mask = index[row, column].astype(np.int64)
    row, column = row * _STEP_PX, column * _STEP_PX
    inverse = rho[row, column].astype(np.float64)
    known = np.bincount(mask, inverse > 0, count)
    pixels = np.bincount(mask, minlength=count)
    chosen = np.flatnonzero(known > 0)
    # Means of inverse depths: pixels of the background at a mask's rim hardly move them.
    z = known[chosen] / np.bincount(mask, inverse, count)[chosen]
    middle = np.stack([np.bincount(mask, column, count), np.bincount(mask, row, count)], axis=-1)
    uv = middle[chosen] / pixels[chosen, None]
    place = se3.transform_points(T_world_camera, pinhole.rays(camera, uv) * z[:, None])
    extent = _STEP_PX * np.sqrt(pixels[chosen]) * z / np.sqrt(camera.fx * camera.fy)
    return MaskSightings(labels[chosen], place, extent, _cut_off(label_index)[chosen],
                         _colours(rgb[row, column], mask, count)[chosen])


def likeness(colours_a: Array, colours_b: Array) -> Array:
    """(A, B) between 0 and 1: how much of the one's colours the other has, the better way round.

    Of two sightings of a thing one may show a part only, where a colour takes up more of the area
    than it does of the whole: up to four times as much.
    """
    a, b = colours_a[:, None], colours_b[None]
    return np.maximum(np.minimum(a, _PART * b).sum(axis=2), np.minimum(_PART * a, b).sum(axis=2))


def _cut_off(label_index: Array) -> Array:
    """(256,) bool: which masks the image's border touches."""
    border = np.concatenate([label_index[0], label_index[-1], label_index[:, 0],
                             label_index[:, -1]])
    return np.bincount(border, minlength=256) > 0


def _colours(rgb: Array, mask: Array, count: int) -> Array:
    """(count, 64) each mask's colour shares, each pixel shared by the nearest levels."""
    histogram = _histogram(rgb, mask, count)
    return np.asarray(histogram / np.maximum(histogram.sum(axis=1, keepdims=True), 1e-12))


@numba.njit(cache=True, nogil=True)
def _histogram(rgb, mask, count):  # type: ignore[no-untyped-def]
    out = np.zeros((count, _LEVELS, _LEVELS, _LEVELS))
    for n in range(len(mask)):
        r, r_up = _level(rgb[n, 0])
        g, g_up = _level(rgb[n, 1])
        b, b_up = _level(rgb[n, 2])
        for i in range(2):
            of_r = r_up if i == 1 else 1.0 - r_up
            for j in range(2):
                of_rg = of_r * (g_up if j == 1 else 1.0 - g_up)
                out[mask[n], r + i, g + j, b] += of_rg * (1.0 - b_up)
                out[mask[n], r + i, g + j, b + 1] += of_rg * b_up
    return out.reshape(count, _LEVELS**3)


@numba.njit(cache=True, nogil=True, inline="always")
def _level(value):  # type: ignore[no-untyped-def]
    """The level below a channel's value, and the next one's share."""
    level = min(max(value * (_LEVELS / 256.0) - 0.5, 0.0), _LEVELS - 1.0)
    low = min(int(level), _LEVELS - 2)
    return low, level - low
