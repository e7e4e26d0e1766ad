"""Detections as a detector gives them: true boxes from masks, and what goes wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import cv2
import numpy as np

from simbench.errors import UserError
from slam.dynamics.detection import COCO_CLASSES, UNKNOWN_CLASS
from slam.geometry.arrays import Array
from slam.types import Boxes2D

_FALSE_SIDE = (0.03, 0.3)     # of a false box, as shares of the image's sides


@dataclass(frozen=True, slots=True)
class BoxNoise:
    """What a detector does to the true boxes."""

    missed: float = 0.05          # probability that a thing is not detected in a frame
    late: float = 0.02            # probability that a frame is given the detections before it
    jitter: float = 0.03          # σ of each side, as a share of the box's width or height
    false_a_frame: float = 0.05   # mean number of boxes around nothing
    confused: float = 0.01        # probability that a box bears a wrong class
    smallest_px: float = 10.0     # smaller things (root of the box's area) are not detected

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            high = np.inf if each.name in ("false_a_frame", "smallest_px") else 1.0
            if not 0.0 <= value <= high:
                raise UserError(f"box noise: {each.name} must be "
                                f"{'at least 0' if high > 1 else 'within 0 and 1'}, got {value}")


def class_number(category: str) -> int:
    """The COCO number of a category, UNKNOWN_CLASS where COCO has none."""
    return COCO_CLASSES.index(category) if category in COCO_CLASSES else UNKNOWN_CLASS


def boxes_of_masks(instance_id: Array, class_of: Mapping[int, int] | None = None) -> Boxes2D:
    """The box around each mask, in the order of the ids; pixels are inclusive.

    Args:
        class_of: id → class number of the things to be detected; None: all, of unknown class.
    """
    seen = np.flatnonzero(np.bincount(instance_id.ravel())[1:]) + 1
    ids = [int(i) for i in seen if class_of is None or int(i) in class_of]
    corners = np.zeros((len(ids), 4))
    for i, number in enumerate(ids):
        u, v, width, height = cv2.boundingRect((instance_id == number).astype(np.uint8))
        corners[i] = u, v, u + width - 1, v + height - 1
    labels = [UNKNOWN_CLASS if class_of is None else class_of[number] for number in ids]
    return Boxes2D(corners, np.ones(len(ids)), np.array(labels, np.int64))


def shuffled_boxes(boxes: Boxes2D, rng: np.random.Generator) -> Boxes2D:
    """In random order, lest the order tell which thing is which."""
    order = rng.permutation(len(boxes.score))
    return Boxes2D(boxes.corners_px[order], boxes.score[order], boxes.label[order])


def is_late(noise: BoxNoise, rng: np.random.Generator) -> bool:
    """Whether a frame is given the detections of the frame before it."""
    return bool(rng.random() < noise.late)


def box_noise(boxes: Boxes2D, noise: BoxNoise, size: tuple[int, int],
              rng: np.random.Generator) -> Boxes2D:
    """Boxes with some missed, the others' sides moved, and false ones among them.

    Args:
        boxes: true ones.
        size: (height, width) of the image; no box goes beyond it.
    """
    height, width = size
    count = len(boxes.score)
    draws = rng.random((2, count))
    extent = boxes.corners_px[:, 2:] - boxes.corners_px[:, :2] + 1.0
    moved = boxes.corners_px + noise.jitter * rng.standard_normal((count, 4)) * np.tile(extent, 2)
    label = np.where(draws[1] < noise.confused, rng.integers(0, len(COCO_CLASSES), count),
                     boxes.label)
    score = 1.0 - 0.5 * rng.random(count)
    kept = (draws[0] >= noise.missed) & (np.sqrt(extent.prod(axis=1)) >= noise.smallest_px)
    false = _false_boxes(int(rng.poisson(noise.false_a_frame)), size, rng)
    corners = np.vstack([np.hstack([np.minimum(moved[:, :2], moved[:, 2:]),
                                    np.maximum(moved[:, :2], moved[:, 2:])])[kept],
                         false.corners_px])
    limits = [width - 1, height - 1, width - 1, height - 1]
    return Boxes2D(np.clip(corners, 0.0, limits), np.concatenate([score[kept], false.score]),
                   np.concatenate([label[kept], false.label]).astype(np.int64))


def _false_boxes(count: int, size: tuple[int, int], rng: np.random.Generator) -> Boxes2D:
    whole = np.array([size[1], size[0]], np.float64)
    extent = whole * rng.uniform(*_FALSE_SIDE, (count, 2))
    start = rng.random((count, 2)) * (whole - extent)
    return Boxes2D(np.hstack([start, start + extent]), 0.3 + 0.4 * rng.random(count),
                   rng.integers(0, len(COCO_CLASSES), count))
