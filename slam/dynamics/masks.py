"""Masks of the same object in consecutive frames, associated by where the flow carries them (III-C)."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array
from slam.types import FlowField

_STEP_PX = 3     # a mask is sampled at every third pixel


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


def place_and_size(index: Array) -> tuple[Array, Array, Array]:
    """Centroid (256, 2) px and area (256,) px of each mask, and whether it touches the border.

    Args:
        index: (H, W) uint8 compact labels.
    """
    step = 2
    sampled = index[::step, ::step]
    rows, columns = np.nonzero(sampled)
    label = sampled[rows, columns]
    area = np.bincount(label, minlength=256).astype(np.float64)
    centroid = np.stack([np.bincount(label, weights=columns, minlength=256),
                         np.bincount(label, weights=rows, minlength=256)], axis=1)
    touches = np.zeros(256, bool)
    for edge in (index[0], index[-1], index[:, 0], index[:, -1]):
        touches[edge] = True
    return step * centroid / np.maximum(area, 1.0)[:, None], step * step * area, touches


def flow_of_masks(flow_px: Array, index_a: Array, index_b: Array,
                  successors: dict[int, int]) -> Array:
    """The flow with the pixels of some masks moved as their masks do: shifted and scaled.

    It brings an object whose motion is not known yet within reach of the flow estimator. A mask
    that touches the border or changes its size by half is left as it is.

    Args:
        flow_px: (H, W, 2) float32 flow expected otherwise.
        successors: index in a -> index in b.
    """
    out = flow_px.copy()
    centroid_a, area_a, border_a = place_and_size(index_a)
    centroid_b, area_b, border_b = place_and_size(index_b)
    for i, j in successors.items():
        ratio = area_b[j] / max(area_a[i], 1.0)
        if border_a[i] or border_b[j] or not 0.5 < ratio < 2.0:
            continue
        rows, columns = np.nonzero(index_a == i)
        scale = np.sqrt(ratio)
        out[rows, columns, 0] = centroid_b[j, 0] + scale * (columns - centroid_a[i, 0]) - columns
        out[rows, columns, 1] = centroid_b[j, 1] + scale * (rows - centroid_a[i, 1]) - rows
    return out
