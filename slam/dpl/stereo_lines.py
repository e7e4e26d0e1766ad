"""Segments of a rectified pair, matched (III-A.1)."""

from __future__ import annotations

import numpy as np

from slam.dpl.config import StereoConfig
from slam.dpl.features import KeyLines
from slam.dpl.matching import as_words, distances
from slam.geometry.arrays import Array


def match_line_pairs(left: KeyLines, right: KeyLines, config: StereoConfig,
                     shape: tuple[int, ...]) -> Array:
    """(L,) for each left segment its partner's row in the right ones, or −1.

    Candidates have their starts or their ends in one cell or in cells above each other; of those
    the nearest descriptor, both ways, that runs alike and beside it.
    """
    n, m = len(left), len(right)
    if n == 0 or m == 0:
        return np.full(n, -1, np.int64)
    a, b = (np.repeat(np.arange(n), m), np.tile(np.arange(m), n))
    close = _share_a_cell(left.ends_px, right.ends_px, config, shape).reshape(-1)
    a, b = a[close], b[close]
    good = (_cosine(left.ends_px[a], right.ends_px[b]) > config.line_cosine) & (
        row_overlap(left.ends_px[a], right.ends_px[b]) > config.line_overlap)
    a, b = a[good], b[good]
    bits = np.full((n, m), 257, np.int64)
    bits[a, b] = distances(as_words(left.descriptor)[a], as_words(right.descriptor)[b])
    best, back = bits.argmin(axis=1), bits.argmin(axis=0)
    mutual = (back[best] == np.arange(n)) & (bits[np.arange(n), best] <= config.line_distance)
    return np.where(mutual, best, -1)


def _share_a_cell(left: Array, right: Array, config: StereoConfig, shape: tuple[int, ...]
                  ) -> Array:
    """(L, R) bool: starts or ends of both lie in one band of rows or in neighbouring ones, and no
    farther apart along the rows than disparities reach."""
    height = max(shape[0] / config.grid_rows, 1.0)
    row_a, row_b = left[:, :, 1] // height, right[:, :, 1] // height               # (L, 2), (R, 2)
    shift = left[:, None, :, 0] - right[None, :, :, 0]
    same = (np.abs(row_a[:, None] - row_b[None]) <= 1) & (shift >= 0.0) & (
        shift <= config.max_disparity_px)
    return np.asarray(same.any(axis=2))


def _cosine(a: Array, b: Array) -> Array:
    u, v = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    length = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    return np.asarray(np.sum(u * v, axis=1) / np.maximum(length, 1e-9))


def row_overlap(a: Array, b: Array) -> Array:
    """(N,) rows that both of two segments (N, 2, 2) cover, over those of the shorter."""
    low_a, high_a = a[:, :, 1].min(axis=1), a[:, :, 1].max(axis=1)
    low_b, high_b = b[:, :, 1].min(axis=1), b[:, :, 1].max(axis=1)
    common = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    return np.asarray(common / np.maximum(np.minimum(high_a - low_a, high_b - low_b), 1e-9))


def line_disparities(left: Array, right: Array, match: Array, least_slope: float = 0.2) -> Array:
    """(L, 2) disparities of the left segments' ends, by the right lines in the same rows.

    0 without a partner, and for segments that lie along a row, where none can be told.

    Args:
        left: (L, 2, 2); right: (R, 2, 2); match: (L,) rows of the right ones, −1: none.
        least_slope: sine of the angle to the rows.
    """
    if not len(right):
        return np.zeros((len(left), 2))
    partner = right[np.maximum(match, 0)]
    along = partner[:, 1] - partner[:, 0]
    own = left[:, 1] - left[:, 0]
    steep = [np.abs(d[:, 1]) > least_slope * np.linalg.norm(d, axis=1) for d in (along, own)]
    told = (match >= 0) & steep[0] & steep[1]
    rise = np.where(told, along[:, 1], 1.0)
    share = (left[:, :, 1] - partner[:, :1, 1]) / rise[:, None]
    u_right = partner[:, :1, 0] + share * along[:, :1]
    return np.where(told[:, None], left[:, :, 0] - u_right, 0.0)
