"""Which features go, given dynamic ones and boxes (III-B.2, Algorithm 1)."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array


def inside_boxes(uv_px: Array, boxes: Array) -> Array:
    """(B, N) bool: which positions (N, 2) lie in which boxes (B, 4): u_min, v_min, u_max, v_max."""
    u, v = uv_px[None, :, 0], uv_px[None, :, 1]
    return np.asarray((u >= boxes[:, :1]) & (v >= boxes[:, 1:2])
                      & (u <= boxes[:, 2:3]) & (v <= boxes[:, 3:4]))


def usable_boxes(corners_px: Array, width: int, height: int) -> Array:
    """(B,) bool: boxes (B, 4) that are finite and cover some of the image."""
    with np.errstate(invalid="ignore"):
        u0, v0, u1, v1 = np.moveaxis(np.asarray(corners_px, dtype=np.float64), 1, 0)
        return np.asarray(np.isfinite(corners_px).all(axis=1) & (u1 > u0) & (v1 > v0)
                          & (u1 > 0) & (v1 > 0) & (u0 < width - 1) & (v0 < height - 1))


def full_boxes(dynamic_px: Array, features_px: Array, boxes: Array, share: float,
               share_of: str, tested_px: Array) -> Array:
    """(B,) bool: boxes whose features all go.

    "frame" is Algorithm 1 as printed: more dynamic features in the box than `share` of all
    features of the frame, which a small box never reaches. "box" counts against the corners that
    were tested in the box itself.
    """
    count = np.count_nonzero(inside_boxes(dynamic_px, boxes), axis=1)
    if share_of == "frame":
        return np.asarray(count > share * len(features_px))
    tested = np.count_nonzero(inside_boxes(tested_px, boxes), axis=1)
    return np.asarray((count > share * tested) & (count > 0))


def cull_points(features_px: Array, dynamic_px: Array, boxes: Array, full: Array,
                near_px: float, near_outside_px: float) -> Array:
    """(N,) bool: which features (N, 2) stay static (Algorithm 1).

    A feature goes in a box that goes whole; in another box when a dynamic feature of the same box
    is near; outside all boxes when a dynamic feature outside all boxes is near.

    Args:
        dynamic_px: (D, 2).
        boxes: (B, 4); full: (B,) from `full_boxes`.
    """
    if not len(dynamic_px) and not full.any():
        return np.ones(len(features_px), bool)
    in_box, dynamic_in = inside_boxes(features_px, boxes), inside_boxes(dynamic_px, boxes)
    gone = np.asarray(in_box[full].any(axis=0))
    square = np.sum((features_px[:, None] - dynamic_px[None]) ** 2, axis=2)
    together = (in_box.T.astype(np.float32) @ dynamic_in.astype(np.float32)) > 0      # (N, D)
    in_none, moves_in_none = np.asarray(~in_box.any(axis=0)), np.asarray(~dynamic_in.any(axis=0))
    outside = in_none[:, None] & moves_in_none[None]
    gone |= (together & (square <= near_px**2)).any(axis=1)
    gone |= (outside & (square <= near_outside_px**2)).any(axis=1)
    return np.asarray(~gone)


def cull_lines(ends_px: Array, dynamic_px: Array, boxes: Array, full: Array, near_px: float,
               near_outside_px: float, samples: int = 7) -> Array:
    """(L,) bool: which segments (L, 2, 2) stay.

    Samples are judged as points are; a segment goes when more than a third of its own go.
    """
    if not len(ends_px):
        return np.zeros(0, bool)
    t = np.linspace(0.0, 1.0, samples)[:, None]
    along = np.asarray(ends_px[:, None, 0] * (1 - t) + ends_px[:, None, 1] * t)
    stays = cull_points(along.reshape(-1, 2), dynamic_px, boxes, full, near_px, near_outside_px)
    return np.asarray(stays.reshape(-1, samples).mean(axis=1) > 2.0 / 3.0)
