"""Noise of instance masks, and the labels under which a system meets them."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from simbench.errors import UserError
from simbench.settings import SIGNED
from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class MaskNoise:
    # > 0: masks shrink by this much; < 0: they grow over background.
    erosion_px: int = field(default=1, metadata={SIGNED: True})
    missed: float = 0.02        # probability that an object is not detected in a frame

    def __post_init__(self) -> None:
        if not 0.0 <= self.missed <= 1.0:
            raise UserError(f"mask noise: missed must be within 0 and 1, got {self.missed}")


def mask_noise(instance_id: Array, noise: MaskNoise, rng: np.random.Generator) -> Array:
    """(H, W) int32 masks with shifted borders and without the objects that were missed."""
    ids = _ids(instance_id)
    missed = ids[rng.random(len(ids)) < noise.missed]
    kept = np.where(np.isin(instance_id, missed), 0, instance_id).astype(np.int32)
    return _resized(kept, noise.erosion_px)


def shuffle_labels(instance_id: Array, rng: np.random.Generator) -> tuple[Array, dict[int, int]]:
    """New labels 1 … n in random order for this frame's objects.

    Returns:
        (H, W) int32 labels, and label → id before the shuffling.
    """
    ids = _ids(instance_id)
    labels = rng.permutation(len(ids)).astype(np.int32) + 1
    position = np.searchsorted(ids, instance_id)
    table = np.append(labels, np.int32(0))
    shuffled = np.where(instance_id > 0, table[position], 0).astype(np.int32)
    return shuffled, {int(label): int(i) for label, i in zip(labels, ids, strict=True)}


def majority_objects(labels: Array, true_id: Array) -> dict[int, int]:
    """Label → the true object that covers most of it; labels mostly on background are left out.

    Args:
        labels, true_id: (H, W) int, 0 = background.
    """
    columns = int(true_id.max(initial=0)) + 1
    cells = labels.astype(np.int64) * columns + true_id
    counts = np.bincount(cells.ravel(), minlength=columns)
    table = np.resize(counts, (-(-len(counts) // columns), columns))
    table.ravel()[len(counts):] = 0
    best = np.argmax(table, axis=1)
    return {int(label): int(best[label]) for label in np.flatnonzero(table.sum(axis=1))
            if label > 0 and best[label] > 0}


def _ids(instance_id: Array) -> Array:
    return np.flatnonzero(np.bincount(instance_id.ravel())[1:]) + 1


def _resized(instance_id: Array, erosion_px: int) -> Array:
    if erosion_px == 0:
        return instance_id
    size = 2 * abs(erosion_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    image = instance_id.astype(np.float32)
    largest = cv2.dilate(image, disc)
    if erosion_px < 0:
        return np.where(instance_id > 0, instance_id, largest.astype(np.int32))
    smallest = cv2.erode(image, disc)
    return np.where(smallest == largest, instance_id, 0).astype(np.int32)
