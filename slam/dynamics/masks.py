"""Masks of the same object in consecutive frames, associated by where the flow carries them (III-C)."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry.arrays import Array
from slam.types import FlowField

_STEP_PX = 3     # a mask is sampled at every third pixel
_SEARCH_PX = 20  # to each side of where a thing is expected, at the scale of the search
_MIN_TEMPLATE_PX = 60
_MAX_TEMPLATE_PX = 4000


def overlaps(flow: FlowField, index_a: Array, index_b: Array) -> Array:
    """How many sampled pixels of each mask in a the flow carries into each mask in b.

    Args:
        index_a, index_b: (H, W) uint8 compact labels, 0 = background.
    Returns:
        votes (256, 256), by index in a and in b.
    """
    sampled = index_a[::_STEP_PX, ::_STEP_PX]
    rows, columns = np.nonzero(sampled)
    rows, columns = rows * _STEP_PX, columns * _STEP_PX
    moved = np.asarray(flow.flow_px)[rows, columns]
    usable = np.isfinite(moved).all(axis=1)
    if flow.valid is not None:
        usable &= flow.valid[rows, columns]
    rows, columns, moved = rows[usable], columns[usable], moved[usable]
    u, v = np.rint(columns + moved[:, 0]), np.rint(rows + moved[:, 1])
    inside = (u >= 0) & (u < index_b.shape[1]) & (v >= 0) & (v < index_b.shape[0])
    pair = (index_a[rows[inside], columns[inside]].astype(np.int64) * 256
            + index_b[v[inside].astype(np.intp), u[inside].astype(np.intp)])
    return np.bincount(pair, minlength=256 * 256).reshape(256, 256)


def associate(votes: Array, labels_a: Array, labels_b: Array, min_share: float) -> dict[int, int]:
    """Label in b -> label in a, one to one, the largest overlaps first.

    Args:
        votes: (256, 256) from `overlaps`.
        labels_a, labels_b: the labels that the indices stand for; [0] is the background.
        min_share: of a mask's sampled pixels that its successor must receive.
    """
    pairs: dict[int, int] = {}
    votes = votes[: len(labels_a), : len(labels_b)]
    total = np.maximum(votes.sum(axis=1, keepdims=True), 1)
    enough = (votes > 0) & (votes >= min_share * total)
    enough[0], enough[:, 0] = False, False
    rows, columns = np.nonzero(enough)
    used: set[int] = set()
    for i in np.argsort(-votes[rows, columns], kind="stable"):
        a, b = int(labels_a[rows[i]]), int(labels_b[columns[i]])
        if a not in used and b not in pairs:
            pairs[b] = a
            used.add(a)
    return pairs


def flow_of_masks(flow_px: Array, index_a: Array, masks: Array, gray_a: Array,
                  gray_b: Array) -> Array:
    """The flow with the pixels of some masks moved as a whole, to where their picture is found.

    It brings an object whose motion is not known yet within reach of the flow estimator.

    Args:
        flow_px: (H, W, 2) float32 flow expected otherwise; each search is centred on it.
        index_a: (H, W) uint8 compact labels.
        masks: (M,) indices of the masks to move.
        gray_a, gray_b: (H, W) uint8.
    """
    out = flow_px.copy()
    for index in masks:
        mask = index_a == index
        rows, columns = np.nonzero(mask)
        if len(rows) < _MIN_TEMPLATE_PX:
            continue
        expected = np.median(flow_px[rows, columns], axis=0)
        top, bottom = rows.min(), rows.max() + 1
        left, right = columns.min(), columns.max() + 1
        shift = _template_shift(gray_a[top:bottom, left:right], mask[top:bottom, left:right],
                                gray_b, left, top, np.rint(expected).astype(int))
        if shift is not None:
            out[rows, columns] = shift
    return out


def _template_shift(template: Array, mask: Array, gray_b: Array, left: int, top: int,
                    expected: Array) -> Array | None:
    """Shift (2,) px by which the masked template fits the other image best; None off the image.

    Large templates are searched on images of half the size, again and again.
    """
    if mask.sum() > _MAX_TEMPLATE_PX:
        half = [cv2.resize(x, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                for x in (template, gray_b)]
        small_mask = cv2.resize(mask.astype(np.uint8), half[0].shape[::-1],
                                interpolation=cv2.INTER_NEAREST).astype(bool)
        found = _template_shift(half[0], small_mask, half[1], left // 2, top // 2, expected // 2)
        return None if found is None else 2.0 * found
    height, width = template.shape
    column, row = left + expected[0] - _SEARCH_PX, top + expected[1] - _SEARCH_PX
    padded = cv2.copyMakeBorder(gray_b, *(4 * [_SEARCH_PX + max(height, width)]),
                                cv2.BORDER_REPLICATE)
    offset = _SEARCH_PX + max(height, width)
    region = padded[max(row + offset, 0):row + offset + height + 2 * _SEARCH_PX,
                    max(column + offset, 0):column + offset + width + 2 * _SEARCH_PX]
    if region.shape[0] < height or region.shape[1] < width or row + offset < 0 or column + offset < 0:
        return None
    cost = cv2.matchTemplate(region, template, cv2.TM_SQDIFF, mask=mask.astype(np.uint8))
    _, _, best, _ = cv2.minMaxLoc(cost)
    return expected + np.array(best, dtype=np.float64) - _SEARCH_PX
