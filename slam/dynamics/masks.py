"""Masks of the same object in two frames, associated by where the flow carries them (III-C)."""

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
