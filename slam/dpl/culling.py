"""Which features go, given dynamic ones and boxes (III-B.2, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numba
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
    return np.asarray(~(gone | _near_dynamic(features_px, dynamic_px, in_box, dynamic_in,
                                             near_px**2, near_outside_px**2)))


@dataclass(frozen=True, slots=True)
class StillGround:
    """Where in a frame nothing was found to move."""

    dynamic_px: Array    # (D, 2) corners that moved
    boxes: Array         # (B, 4) usable boxes
    full: Array          # (B,) bool: culled whole
    near_px: float       # of a corner that moved and is in the same box
    near_outside_px: float       # of one outside all boxes

    def holds(self, uv_px: Array) -> Array:
        """(N,) bool: which positions (N, 2) are static (Algorithm 1)."""
        return cull_points(uv_px, self.dynamic_px, self.boxes, self.full, self.near_px,
                           self.near_outside_px)


@numba.njit(cache=True, nogil=True)
def _near_dynamic(features, dynamic, in_box, dynamic_in,  # type: ignore[no-untyped-def]
                  near2, near_outside2):
    """(N,) bool: with a dynamic feature of the same box near, or of no box where it is in none."""
    out = np.zeros(len(features), np.bool_)
    farthest2 = max(near2, near_outside2)
    for n in range(len(features)):
        for d in range(len(dynamic)):
            du, dv = features[n, 0] - dynamic[d, 0], features[n, 1] - dynamic[d, 1]
            square = du * du + dv * dv
            if square > farthest2:
                continue
            together, inside = False, False
            for b in range(len(in_box)):
                together |= in_box[b, n] and dynamic_in[b, d]
                inside |= in_box[b, n] or dynamic_in[b, d]
            if (together and square <= near2) or (not inside and square <= near_outside2):
                out[n] = True
                break
    return out


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
