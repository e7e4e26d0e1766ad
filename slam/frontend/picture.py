"""Things whose motion is not known yet, found again by their picture.

A dense flow estimator loses a small thing that moves fast against its surroundings. A template
search and corners tracked from there bring it within reach; where the flow that was estimated
then explains the images worse than what was expected, the expected flow stays.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from slam.frontend.sampling import bilinear
from slam.geometry.arrays import Array

_SEARCH_PX = 20  # to each side of where a thing is expected, at the scale of the search
_MIN_TEMPLATE_PX = 60
_MAX_TEMPLATE_PX = 4000
_AFFINE_CORNERS = 100
_MIN_AFFINE = 8
_COMPARED_PX = 4000  # pixels on which two flows are compared
_LARGEST_GAP = 50.0  # grey levels; a larger difference says no more
_CLEARLY = 0.7       # of the other flow's difference: estimated flow is better where it works


def flow_of_masks(flow_px: Array, index_a: Array, masks: Array, gray_a: Array,
                  gray_b: Array) -> Array:
    """The flow with the pixels of some masks moved to where their picture is found.

    It brings an object whose motion is not known yet within reach of the flow estimator: a
    template search finds its shift, and corners tracked from there its affine motion.

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
        # A thing that rides along with the camera hardly moves in the image.
        found = [_template_shift(gray_a[top:bottom, left:right], mask[top:bottom, left:right],
                                 gray_b, left, top, centre)
                 for centre in (np.rint(expected).astype(int), np.zeros(2, int))]
        cost, shift = min(found)
        if cost < np.inf:
            affine = _affine_motion(gray_a, gray_b, mask, np.array(shift, dtype=np.float32))
            uv = np.stack([columns, rows], axis=1).astype(np.float64)
            out[rows, columns] = shift
            moved = uv @ affine[:, :2].T + affine[:, 2]
            _keep_better(out, rows, columns, moved - uv, gray_a, gray_b)
    return out


def better_flow(flow_px: Array, expected_px: Array, index_a: Array, masks: Array, gray_a: Array,
                gray_b: Array) -> Array:
    """The estimated flow (H, W, 2), but on masks that the expected one explains better that one."""
    asked = np.zeros(256, np.bool_)
    asked[masks] = True
    pixels, gaps = _gaps_of_masks(flow_px, expected_px, index_a, asked, gray_a, gray_b)
    better = asked & (pixels > 0) & (gaps[:, 1] < _CLEARLY * gaps[:, 0])
    if not better.any():
        return flow_px
    return np.where(better[index_a][:, :, None], expected_px, flow_px)


def static_gaps(flow_px: Array, other_px: Array, index_a: Array, gray_a: Array,
                gray_b: Array) -> tuple[float, float]:
    """Sums of grey differences off all masks under two flows (H, W, 2), on the same pixels."""
    asked = np.zeros(256, np.bool_)
    asked[0] = True
    _, gaps = _gaps_of_masks(flow_px, other_px, index_a, asked, gray_a, gray_b)
    return float(gaps[0, 0]), float(gaps[0, 1])


@numba.njit(cache=True, nogil=True)
def _gaps_of_masks(flow, other, index, asked, gray_a, gray_b):  # type: ignore[no-untyped-def]
    """Pixels (256,) of each mask, and the sums of grey differences (256, 2) under two flows."""
    pixels, gaps = np.zeros(256, np.int64), np.zeros((256, 2))
    for v in range(index.shape[0]):
        for u in range(index.shape[1]):
            pixels[index[v, u]] += 1
    every = np.maximum(pixels // _COMPARED_PX, 1)
    met = np.zeros(256, np.int64)
    for v in range(index.shape[0]):
        for u in range(index.shape[1]):
            own = index[v, u]
            if not asked[own]:
                continue
            met[own] += 1
            if (met[own] - 1) % every[own] == 0:
                here = float(gray_a[v, u])
                gaps[own, 0] += _gap(gray_b, u + flow[v, u, 0], v + flow[v, u, 1], here)
                gaps[own, 1] += _gap(gray_b, u + other[v, u, 0], v + other[v, u, 1], here)
    return pixels, gaps


@numba.njit(cache=True, nogil=True)
def _gap(gray, u, v, here):  # type: ignore[no-untyped-def]
    """Difference of a grey level and the image at a position; its border repeats."""
    if not (np.isfinite(u) and np.isfinite(v)):
        return _LARGEST_GAP
    height, width = gray.shape
    u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
    left, top = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
    right, below = min(left + 1, width - 1), min(top + 1, height - 1)
    a, b = u - left, v - top
    there = ((1 - b) * ((1 - a) * gray[top, left] + a * gray[top, right])
             + b * ((1 - a) * gray[below, left] + a * gray[below, right]))
    return min(abs(there - here), _LARGEST_GAP)


def _keep_better(flow_px: Array, rows: Array, columns: Array, other_px: Array, gray_a: Array,
                 gray_b: Array) -> None:
    """Put the other flow on these pixels if the images differ clearly less under it."""
    some = slice(None, None, max(1, len(rows) // _COMPARED_PX))
    here = gray_a[rows[some], columns[some]].astype(np.float64)

    def difference(flow: Array) -> float:
        there = np.stack([columns[some] + flow[:, 0], rows[some] + flow[:, 1]], axis=1)
        gap = np.abs(bilinear(gray_b, there) - here)
        return float(np.mean(np.minimum(gap, _LARGEST_GAP)))

    if difference(other_px[some]) < _CLEARLY * difference(flow_px[rows[some], columns[some]]):
        flow_px[rows, columns] = other_px


def _affine_motion(gray_a: Array, gray_b: Array, mask: Array, shift: Array) -> Array:
    """(2, 3) affine motion of a mask's corners, tracked from the shift; the shift if too few."""
    shifted = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    corners = cv2.goodFeaturesToTrack(gray_a, _AFFINE_CORNERS, 0.01, 4.0,
                                      mask=mask.astype(np.uint8))
    if corners is None or len(corners) < _MIN_AFFINE:
        return shifted
    options = {"winSize": (21, 21), "maxLevel": 2, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
    there, found, _ = cv2.calcOpticalFlowPyrLK(gray_a, gray_b, corners, corners + shift, **options)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(gray_b, gray_a, there, corners.copy(), **options)
    gap = np.linalg.norm((back - corners).reshape(-1, 2), axis=1)
    good = (found.ravel() > 0) & (returned.ravel() > 0) & (gap < 1.0)
    if np.count_nonzero(good) < _MIN_AFFINE:
        return shifted
    affine, inliers = cv2.estimateAffine2D(corners[good], there[good], ransacReprojThreshold=2.0)
    enough = affine is not None and np.count_nonzero(inliers) >= _MIN_AFFINE
    return np.asarray(affine) if enough else shifted


def _template_shift(template: Array, mask: Array, gray_b: Array, left: int, top: int,
                    expected: Array) -> tuple[float, tuple[float, float]]:
    """Squared difference and shift, in px, of the masked template's best fit; inf off the image.

    Large templates are searched on images of half the size, again and again.
    """
    if mask.sum() > _MAX_TEMPLATE_PX:
        half = [cv2.resize(x, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                for x in (template, gray_b)]
        small_mask = cv2.resize(mask.astype(np.uint8), half[0].shape[::-1],
                                interpolation=cv2.INTER_NEAREST).astype(bool)
        cost, (du, dv) = _template_shift(half[0], small_mask, half[1], left // 2, top // 2,
                                         expected // 2)
        return 4.0 * cost, (2.0 * du, 2.0 * dv)
    height, width = template.shape
    margin = _SEARCH_PX + max(height, width)
    row = top + expected[1] - _SEARCH_PX + margin
    column = left + expected[0] - _SEARCH_PX + margin
    padded = cv2.copyMakeBorder(gray_b, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    region = padded[max(row, 0):row + height + 2 * _SEARCH_PX,
                    max(column, 0):column + width + 2 * _SEARCH_PX]
    if min(row, column) < 0 or region.shape[0] < height or region.shape[1] < width:
        return np.inf, (0.0, 0.0)
    difference = cv2.matchTemplate(region, template, cv2.TM_SQDIFF, mask=mask.astype(np.uint8))
    cost, _, best, _ = cv2.minMaxLoc(difference)
    return cost, (float(expected[0] + best[0] - _SEARCH_PX),
                  float(expected[1] + best[1] - _SEARCH_PX))
