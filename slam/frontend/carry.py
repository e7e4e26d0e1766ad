"""Masks that a detector missed, carried on from the frame before by the flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np

from slam.frontend.observe import NO_GROUP, Observation
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.types import FlowField, Intrinsics

_DEPTH_SHARE = 0.1       # relative inverse-depth difference up to which a pixel is the object's
_DEPTH_SIGMAS = 4.0
_FEWEST_PX = 30


def carry_missed(a: Observation, b: Observation, flow: FlowField, T_b_a: Mapping[int, Array],
                 camera: Intrinsics, inverse_depth_sigma: float, min_share: float
                 ) -> tuple[Observation, dict[int, int]]:
    """Frame b with the masks of objects that it shows but that were not detected in it.

    A pixel of a's mask is carried to where the flow leads, if no mask is there and the depth there
    is the one that the object would have. What hides an object is nearer: then nothing is carried.

    Args:
        T_b_a: mask label in a -> (4, 4) that takes its points to camera b as is expected.
        min_share: of a mask's pixels that must arrive.
    Returns:
        b with the masks added, under labels that no mask of b has; those labels -> label in a.
    """
    names = [label for label in T_b_a if label in a.labels]
    names = names[: max(0, NO_GROUP - len(b.labels))]
    if not names:
        return b, {}
    group = a.groups({label: g for g, label in enumerate(names, start=1)})
    row, column = np.nonzero((group > 0) & (group < NO_GROUP))
    own = group[row, column].astype(np.int64) - 1
    size = np.bincount(own, minlength=len(names))
    moved = np.asarray(flow.flow_px)[row, column]
    usable = np.isfinite(moved).all(axis=1)
    if flow.valid is not None:
        usable &= flow.valid[row, column]
    row, column, own, moved = row[usable], column[usable], own[usable], moved[usable]
    u, v = np.rint(column + moved[:, 0]), np.rint(row + moved[:, 1])
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    row, column, own = row[inside], column[inside], own[inside]
    u, v = u[inside].astype(np.intp), v[inside].astype(np.intp)
    T = np.stack([T_b_a[label] for label in names])[own]
    expected = _expected_inverse_depth(T, column, row, a.rho[row, column], camera)
    there = b.rho[v, u]
    tolerance = _DEPTH_SHARE * expected + _DEPTH_SIGMAS * inverse_depth_sigma
    known = (expected > 0) & (there > 0)
    same = (b.label_index[v, u] == 0) & (~known | (np.abs(there - expected) < tolerance))
    arrived = np.bincount(own[same & known], minlength=len(names))
    chosen = np.flatnonzero((arrived >= min_share * size) & (arrived >= _FEWEST_PX))
    if not len(chosen):
        return b, {}
    index = np.array(b.label_index)
    labels = int(b.labels.max()) + 1 + np.arange(len(chosen))
    for number, g in enumerate(chosen):
        mask = np.zeros(index.shape, np.uint8)
        mine = same & (own == g)
        mask[v[mine], u[mine]] = 1
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        index[(mask > 0) & (b.label_index == 0)] = len(b.labels) + number
    every = np.concatenate([b.labels, labels])
    return (replace(b, labels=every, label_index=index, instance_id=_label_image(every, index),
                    carried=tuple(labels.tolist())),
            {int(label): names[g] for label, g in zip(labels, chosen, strict=True)})


def _expected_inverse_depth(T_b_a: Array, u: Array, v: Array, rho_a: Array, camera: Intrinsics
                            ) -> Array:
    """(N,) 1/m in b; 0 where a has no depth."""
    rays = pinhole.rays(camera, np.stack([u, v], axis=-1).astype(np.float64))
    z = np.einsum("ni,ni->n", T_b_a[:, 2, :3], rays) + rho_a * T_b_a[:, 2, 3]
    return np.where((rho_a > 0) & (z > 0), rho_a / np.maximum(z, 1e-9), 0.0)


def _label_image(labels: Array, index: Array) -> Array:
    """(H, W) int32 label of each pixel; masks without a group are a label of their own."""
    table = np.full(256, int(labels.max()) + 1, np.int32)
    table[: len(labels)] = labels
    return table[index]
