"""What is computed of a frame once, for its use as the current and then the previous one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np

from slam.geometry.arrays import Array
from slam.types import Frame

NO_GROUP = 255           # pixels of a mask that takes part in no motion
_MOST_LABELS = 254
_LARGEST_TABLE = 1_000_000
_NEAREST_M = 1e-3        # nearer is no depth, and its inverse may be too large for float32


@dataclass(frozen=True, slots=True)
class Observation:
    """One frame, prepared."""

    frame: Frame
    gray: Array          # (H, W) uint8
    rho: Array           # (H, W) float32 inverse depth, 0 = unknown
    labels: Array        # (n + 1,) mask labels; labels[0] = 0, the background
    label_index: Array   # (H, W) uint8: index into labels; 255 = a mask beyond the 254 largest
    instance_id: Array | None   # (H, W) int32 the labels themselves; None = no masks
    carried: tuple[int, ...] = ()   # labels of masks that were not given but carried here

    def shifted(self, offset: float) -> Observation:
        """The same with an offset, 1/m, added to every inverse depth that is known."""
        if offset == 0.0:
            return self
        moved = np.maximum(self.rho + np.float32(offset), np.float32(1e-6))
        return replace(self, rho=np.where(self.rho > 0, moved, np.float32(0)))

    def groups(self, group_of_label: dict[int, int]) -> Array:
        """(H, W) uint8 motion group of each pixel: 0 on the background, 255 on unnamed masks."""
        table = np.full(256, NO_GROUP, np.uint8)
        for index, label in enumerate(self.labels):
            table[index] = group_of_label.get(int(label), NO_GROUP)
        table[0] = 0
        return np.asarray(cv2.LUT(self.label_index, table))


def observe(frame: Frame) -> Observation:
    """Grey image, inverse depth and compact labels of a frame."""
    gray = cv2.cvtColor(np.ascontiguousarray(frame.rgb), cv2.COLOR_RGB2GRAY)
    depth = np.asarray(frame.depth_m, dtype=np.float32)
    rho = np.divide(np.float32(1), depth, out=np.zeros_like(depth),
                    where=np.isfinite(depth) & (depth > _NEAREST_M))
    labels, index = _compact(frame.instance_id, gray.shape)
    return Observation(frame, gray, rho, labels, index, frame.instance_id)


def _compact(instance_id: Array | None, shape: tuple[int, ...]) -> tuple[Array, Array]:
    if instance_id is None or not instance_id.any():
        return np.zeros(1, np.int64), np.zeros(shape, np.uint8)
    ids = np.ascontiguousarray(instance_id)
    if int(ids.max()) > _LARGEST_TABLE:       # hashes as labels: a table would be too large
        values, inverse = np.unique(np.maximum(ids, 0), return_inverse=True)
        ids = inverse.reshape(shape).astype(np.int32) + int(values[0] > 0)
        values = values[values > 0]
    else:
        values = np.arange(1, int(ids.max()) + 1)
    count = _count(ids, len(values) + 1)[1:]
    kept = np.flatnonzero(count)
    if len(kept) > _MOST_LABELS:
        kept = np.sort(kept[np.argsort(-count[kept], kind="stable")[:_MOST_LABELS]])
    table = np.full(len(values) + 1, NO_GROUP, np.uint8)
    table[0] = 0
    table[kept + 1] = np.arange(1, len(kept) + 1)
    return np.concatenate([[0], values[kept]]).astype(np.int64), _looked_up(ids, table)


@numba.njit(cache=True, nogil=True)
def _count(ids, size):  # type: ignore[no-untyped-def]
    """Pixels of each number (size,); negative ones count as 0."""
    count = np.zeros(size, np.int64)
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            count[max(ids[row, column], 0)] += 1
    return count


@numba.njit(cache=True, nogil=True)
def _looked_up(ids, table):  # type: ignore[no-untyped-def]
    out = np.empty(ids.shape, np.uint8)
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            out[row, column] = table[max(ids[row, column], 0)]
    return out
