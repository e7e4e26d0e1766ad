"""Corners spread over a grid, denser on objects, away from borders and from living tracks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from slam.geometry.arrays import Array

_RADIUS_PX = 2      # of the corner's window


@dataclass(frozen=True, slots=True)
class PointConfig:
    """Where new points may stand."""

    static_cell_px: int = 16          # one point per cell: 1,200 cells at 640×480
    object_cell_px: int = 5           # finer, so that a small object carries enough points
    object_count: int = 400           # most new points on one object and frame
    mask_margin_px: int = 2           # a 2×2 flow or depth lookup and mask errors of 1–2 px
    border_margin_px: int = 8         # the refinement's patch and its moves stay in the image
    track_margin_px: int = 4          # distance of a new point to living tracks
    min_eigenvalue: float = 0.1       # (grey/px)²; weak patches say so in their covariance


def corner_response(gray: Array) -> Array:
    """(H, W) float32: smaller eigenvalue of the mean structure tensor over 5×5 px, (grey/px)²."""
    dx, dy = cv2.spatialGradient(np.ascontiguousarray(gray))
    return np.asarray(_smaller_eigenvalue(dx, dy))


@numba.njit(cache=True, nogil=True)
def _smaller_eigenvalue(dx, dy):  # type: ignore[no-untyped-def]
    """Of the mean of g gᵀ over a window; sums are of whole numbers, hence exact."""
    height, width = dx.shape
    side = 2 * _RADIUS_PX + 1
    out = np.zeros((height, width), np.float32)
    scale = np.float32(1.0 / (64 * side * side))        # Sobel's kernel has a gain of 8
    xx, xy, yy = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros(width, np.int32)
    for v in range(height):
        for u in range(width):                          # sums over the rows of the window
            gx, gy = np.int32(dx[v, u]), np.int32(dy[v, u])
            xx[u] += gx * gx
            xy[u] += gx * gy
            yy[u] += gy * gy
        if v >= side:
            for u in range(width):
                gx, gy = np.int32(dx[v - side, u]), np.int32(dy[v - side, u])
                xx[u] -= gx * gx
                xy[u] -= gx * gy
                yy[u] -= gy * gy
        if v < side - 1:
            continue
        for u in range(_RADIUS_PX, width - _RADIUS_PX):
            a, b, c = np.int32(0), np.int32(0), np.int32(0)
            for k in range(-_RADIUS_PX, _RADIUS_PX + 1):
                a += xx[u + k]
                b += xy[u + k]
                c += yy[u + k]
            half = np.float32(0.5) * np.float32(a - c)
            root = np.sqrt(half * half + np.float32(b) * np.float32(b))
            out[v - _RADIUS_PX, u] = scale * (np.float32(0.5) * np.float32(a + c) - root)
    return out


def detect_points(response: Array, count: int, instance_id: Array | None = None,
                  existing_uv: Array | None = None,
                  config: PointConfig | None = None) -> tuple[Array, Array]:
    """New corners, the strongest of each grid cell.

    Args:
        response: (H, W) float32 from `corner_response`.
        count: at most so many points off objects; objects have `object_count` each besides.
        instance_id: (H, W) int, 0 = background; None: no objects.
        existing_uv: (M, 2) points that live already: no new one comes near them.
        config: distances and grid.
    Returns:
        uv_px (N, 2) float64 and their response (N,). Both are empty on an image without texture.
    """
    config = PointConfig() if config is None else config
    labels = np.zeros((1, 1), np.int32) if instance_id is None else np.asarray(instance_id)
    static, moving = _best_of_cells(
        response, labels, _near(response.shape, existing_uv, config.track_margin_px),
        config.static_cell_px, config.object_cell_px, config.border_margin_px,
        config.mask_margin_px, config.min_eigenvalue)
    flat = response.reshape(-1)
    chosen = static[np.sort(np.argsort(-flat[static], kind="stable")[:max(count, 0)])]
    if len(moving):
        label = labels.reshape(-1)[moving]
        order = np.lexsort((-flat[moving], label))
        starts = np.searchsorted(label[order], label[order], side="left")
        within = order[np.arange(len(order)) - starts < config.object_count]
        chosen = np.concatenate([chosen, moving[np.sort(within)]])
    v, u = np.divmod(chosen, response.shape[1])
    return np.stack([u, v], axis=-1).astype(np.float64), flat[chosen].astype(np.float64)


@numba.njit(cache=True, nogil=True)
def _best_of_cells(response, labels, taken, static_cell, object_cell,  # type: ignore[no-untyped-def]
                   border, margin, weakest):
    """Flat numbers of the strongest allowed pixel of each cell: background, then objects.

    A pixel is looked at closely only where it would be its cell's best so far.
    """
    height, width = response.shape
    one_label = labels.size == 1
    across = (-(-width // static_cell), -(-width // object_cell))
    places = (np.full(across[0] * -(-height // static_cell), -1),
              np.full(1 if one_label else across[1] * -(-height // object_cell), -1))
    best = (np.full(len(places[0]), weakest), np.full(len(places[1]), weakest))
    top, left = _first(labels)        # the fine grid moves with what moves
    column = (np.arange(width) // static_cell,
              np.maximum(np.arange(width) - left, 0) // object_cell)
    for v in range(border, height - border):
        row = (v // static_cell * across[0], max(v - top, 0) // object_cell * across[1])
        for u in range(border, width - border):
            kind = 0 if one_label or labels[v, u] == 0 else 1
            cell = row[kind] + column[kind][u]
            if response[v, u] <= best[kind][cell] or taken[v, u]:
                continue
            if one_label or _alike(labels, v, u, margin):
                best[kind][cell], places[kind][cell] = response[v, u], v * width + u
    return places[0][places[0] >= 0], places[1][places[1] >= 0]


@numba.njit(cache=True, nogil=True)
def _first(labels):  # type: ignore[no-untyped-def]
    """First row and first column with a label that is not 0."""
    top, left = labels.shape
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] != 0:
                top, left = min(top, v), min(left, u)
    return top, left


@numba.njit(cache=True, nogil=True)
def _alike(labels, v, u, margin):  # type: ignore[no-untyped-def]
    """Whether all pixels within a margin have the middle one's label."""
    for y in range(max(v - margin, 0), min(v + margin + 1, labels.shape[0])):
        for x in range(max(u - margin, 0), min(u + margin + 1, labels.shape[1])):
            if labels[y, x] != labels[v, u]:
                return False
    return True


def _near(shape: tuple[int, ...], uv: Array | None, by_px: int) -> Array:
    """(H, W) bool: the squares of 2 by_px + 1 pixels around positions (M, 2)."""
    near = np.zeros(shape, np.uint8)
    if uv is None or len(uv) == 0:
        return near.view(np.bool_)
    finite = uv[np.isfinite(uv).all(axis=-1)]
    column, row = np.rint(finite).astype(np.intp).T
    keep = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
    near[row[keep], column[keep]] = 1
    side = 2 * by_px + 1
    return np.asarray(cv2.dilate(near, np.ones((side, side), np.uint8))).view(np.bool_)
