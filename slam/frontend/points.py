"""Corners spread over a grid, denser on objects, away from borders and from living tracks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slam.geometry.arrays import Array


@dataclass(frozen=True, slots=True)
class PointConfig:
    """Where new points may stand."""

    static_cell_px: int = 16          # one point per cell: 1,200 cells at 640×480
    object_cell_px: int = 5           # finer, so that a small object carries enough points
    object_count: int = 400           # most new points on one object and frame
    mask_margin_px: int = 2           # a 2×2 flow or depth lookup and mask errors of 1–2 px
    border_margin_px: int = 8         # the refinement's patch and its moves stay in the image
    track_margin_px: int = 4          # distance of a new point to living tracks
    block_px: int = 5                 # window of the corner's structure tensor
    min_eigenvalue: float = 0.1       # (grey/px)²; weak patches say so in their covariance


def detect_points(gray: Array, count: int, instance_id: Array | None = None,
                  existing_uv: Array | None = None,
                  config: PointConfig | None = None) -> tuple[Array, Array]:
    """New corners (Shi–Tomasi), the strongest of each grid cell.

    Args:
        gray: (H, W) uint8.
        count: at most so many points off objects; objects have `object_count` each besides.
        instance_id: (H, W) int, 0 = background; None: no objects.
        existing_uv: (M, 2) points that live already: no new one comes near them.
        config: distances and grid.
    Returns:
        uv_px (N, 2) float64 and their response (N,), the smaller eigenvalue of the mean
        structure tensor in (grey/px)². Both are empty on an image without texture.
    """
    config = PointConfig() if config is None else config
    return pick_points(corner_strength(gray, instance_id, config), count, instance_id,
                       existing_uv, config)


def corner_strength(gray: Array, instance_id: Array | None, config: PointConfig) -> Array:
    """(H, W) float32 corner response, 0 too near to the image's border or a mask's."""
    response = corner_response(gray, config.block_px)
    if instance_id is not None:
        response[_mask_borders(instance_id, config.mask_margin_px)] = 0.0
    b = config.border_margin_px
    if b > 0:
        response[:b] = response[-b:] = 0.0
        response[:, :b] = response[:, -b:] = 0.0
    return response


def pick_points(strength: Array, count: int, instance_id: Array | None,
                existing_uv: Array | None, config: PointConfig) -> tuple[Array, Array]:
    """`detect_points` where `corner_strength` has been computed; it is left as it is."""
    response = strength
    if existing_uv is not None and len(existing_uv):
        response = np.where(_near(existing_uv, strength.shape, config.track_margin_px),
                            np.float32(0), strength)
    if instance_id is None or not instance_id.any():
        at = _strongest(*_best_per_cell(response, config.static_cell_px), count, config)
    else:
        on_object = instance_id != 0
        background = np.where(on_object, np.float32(0), response)
        static = _strongest(*_best_per_cell(background, config.static_cell_px), count, config)
        row0, column0, window = _bounding_window(on_object)
        row, column, best = _best_per_cell(np.where(on_object[window], response[window],
                                                    np.float32(0)), config.object_cell_px)
        row, column = row + row0, column + column0
        moving = _strongest_per_label(row, column, best, instance_id[row, column], config)
        at = (np.concatenate([static[0], moving[0]]), np.concatenate([static[1], moving[1]]))
    uv = np.stack([at[1], at[0]], axis=-1).astype(np.float64)
    return uv, response[at].astype(np.float64)


def corner_response(gray: Array, block_px: int) -> Array:
    """(H, W) float32: smaller eigenvalue of the mean structure tensor, (grey/px)²."""
    # OpenCV scales an 8-bit image to [0, 1] and gives Sobel derivatives a gain of 2.
    return np.asarray(cv2.cornerMinEigenVal(gray, block_px)) * np.float32(255.0 ** 2 / 4.0)


def _mask_borders(instance_id: Array, margin_px: int) -> Array:
    """(H, W) bool: the pixels nearer to another label than `margin_px`, diagonals included."""
    across = instance_id[:, 1:] != instance_id[:, :-1]
    along = instance_id[1:] != instance_id[:-1]
    edge = np.zeros(instance_id.shape, np.uint8)
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= along
    edge[:-1] |= along
    diagonal = instance_id[1:, 1:] != instance_id[:-1, :-1]
    other = instance_id[1:, :-1] != instance_id[:-1, 1:]
    edge[1:, 1:] |= diagonal
    edge[:-1, :-1] |= diagonal
    edge[1:, :-1] |= other
    edge[:-1, 1:] |= other
    # Both pixels of a border are marked, so a box of margin − 1 leaves `margin` pixels free.
    return _grown(edge, margin_px - 1).astype(bool)


def _near(uv_px: Array, shape: tuple[int, ...], margin_px: int) -> Array:
    """(H, W) bool: the pixels within a margin of positions (N, 2)."""
    taken = np.zeros(shape, np.uint8)
    finite = uv_px[np.isfinite(uv_px).all(axis=-1)]
    column, row = np.rint(finite).astype(np.intp).T
    keep = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
    taken[row[keep], column[keep]] = 1
    return _grown(taken, margin_px).astype(bool)


def _grown(mask: Array, by_px: int) -> Array:
    """The mask with every set pixel grown to a square of 2 by_px + 1 pixels."""
    if by_px <= 0:
        return mask
    side = 2 * by_px + 1
    return np.asarray(cv2.dilate(mask, np.ones((side, side), np.uint8)))


def _bounding_window(mask: Array) -> tuple[int, int, tuple[slice, slice]]:
    """First row, first column and slices of the box around the set pixels."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    return int(rows[0]), int(columns[0]), window


def _best_per_cell(response: Array, cell_px: int) -> tuple[Array, Array, Array]:
    """Row, column and response of the strongest pixel of each cell of a grid."""
    height, width = response.shape
    down, across = -height % cell_px, -width % cell_px
    padded = cv2.copyMakeBorder(response, 0, down, 0, across, cv2.BORDER_CONSTANT, value=0.0)
    rows, columns = padded.shape[0] // cell_px, padded.shape[1] // cell_px
    cells = np.ascontiguousarray(
        padded.reshape(rows, cell_px, columns, cell_px).transpose(0, 2, 1, 3)
    ).reshape(rows * columns, cell_px * cell_px)
    best = cells.argmax(axis=1)
    cell_row, cell_column = np.divmod(np.arange(rows * columns), columns)
    strength = cells[np.arange(len(cells)), best]
    # A cell without response puts its maximum on its first pixel, which may be padding.
    row = np.minimum(cell_row * cell_px + best // cell_px, height - 1)
    column = np.minimum(cell_column * cell_px + best % cell_px, width - 1)
    return row, column, strength


def _strongest(row: Array, column: Array, strength: Array, count: int,
               config: PointConfig) -> tuple[Array, Array]:
    """Rows and columns of the `count` strongest above the threshold, in raster order."""
    good = np.flatnonzero(strength >= config.min_eigenvalue)
    if len(good) > count:
        good = np.sort(good[np.argsort(-strength[good], kind="stable")[:max(count, 0)]])
    return row[good], column[good]


def _strongest_per_label(row: Array, column: Array, strength: Array, label: Array,
                         config: PointConfig) -> tuple[Array, Array]:
    """Rows and columns of the `object_count` strongest of each label above the threshold."""
    good = np.flatnonzero(strength >= config.min_eigenvalue)
    order = good[np.lexsort((-strength[good], label[good]))]
    starts = np.searchsorted(label[order], label[order], side="left")
    order = np.sort(order[np.arange(len(order)) - starts < config.object_count])
    return row[order], column[order]
