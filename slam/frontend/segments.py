"""Line segments: detection, and culling by depth and masks along the whole segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from slam.frontend.sampling import inside, nearest
from slam.geometry.arrays import Array

Detector = Literal["lsd", "edge_drawing"]


@dataclass(frozen=True, slots=True)
class SegmentConfig:
    """Which segments are kept."""

    samples: int = 16                 # positions along a segment where depth and mask are read
    side_px: float = 1.5              # besides the line itself, so far to both sides
    relative_tolerance: float = 0.02  # of inverse depth, from a straight line in 1/z
    inverse_depth_sigma: float = 0.002   # 1/m: 0.002 z² m, and 1 px of disparity on KITTI
    fitting_share: float = 0.85       # of the samples must fit one straight line in 1/z
    label_share: float = 0.9          # of the samples must lie on one mask


def detect_segments(gray: Array, detector: Detector = "edge_drawing",
                    min_length_px: float = 25.0) -> Array:
    """Line segments (N, 2, 2), float64: start and end, (u, v).

    Args:
        gray: (H, W) uint8.
        detector: "lsd" is the paper's; "edge_drawing" takes a fifth of its time.
        min_length_px: shorter ones are dropped; the default is short of a tenth of a VGA image.
    Raises:
        ValueError: no such detector.
    """
    if detector == "lsd":
        found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(gray)[0]
    elif detector == "edge_drawing":
        drawing = cv2.ximgproc.createEdgeDrawing()
        parameters = cv2.ximgproc.EdgeDrawing.Params()
        parameters.MinLineLength = int(min_length_px)
        drawing.setParams(parameters)
        drawing.detectEdges(gray)
        found = drawing.detectLines()
    else:
        raise ValueError(f"no segment detector {detector!r}; there are lsd, edge_drawing")
    if found is None:
        return np.zeros((0, 2, 2))
    endpoints = np.asarray(found, dtype=np.float64).reshape(-1, 2, 2)
    length = np.linalg.norm(endpoints[:, 1] - endpoints[:, 0], axis=-1)
    return endpoints[np.isfinite(length) & (length >= min_length_px)]


def cull_segments(endpoints_px: Array, depth_m: Array, instance_id: Array | None = None,
                  config: SegmentConfig | None = None) -> tuple[Array, Array, Array]:
    """Which segments lie on one surface of one object, and the depth of their ends.

    Inverse depth is linear along the image of a straight line. It is read on the segment and to
    both of its sides; each of the three is fitted robustly. On a depth border the sides
    disagree: the nearer one owns the edge. A segment goes when its depth does not follow the
    fit along its whole length, or when its ends or its samples lie on different masks.

    Args:
        endpoints_px: (N, 2, 2).
        depth_m: (H, W), 0 where there is none.
        instance_id: (H, W) labels, 0 = background; None: all background.
    Returns:
        kept (N,) bool, instance_id (N,) int32, depth_m (N, 2) of both ends from the fit;
        0 where culled.
    """
    config = SegmentConfig() if config is None else config
    count = len(endpoints_px)
    if count == 0:
        return np.zeros(0, bool), np.zeros(0, np.int32), np.zeros((0, 2))
    t = np.linspace(0.0, 1.0, config.samples)
    samples = _sample_positions(endpoints_px, t, config.side_px)            # (N, 3, M, 2)
    depth = np.where(inside(samples, depth_m.shape), nearest(depth_m, samples), 0.0)
    known = np.isfinite(depth) & (depth > 0)
    inverse = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    line, fits = _fit_inverse_depth(t, inverse, known, config)              # (N, 3, 2), (N, 3)
    side = _owning_side(line, fits, config)
    each = np.arange(count)
    ends = np.where((side == _BOTH)[:, None], line.mean(axis=1), line[each, side % 3])
    if instance_id is None:
        label, same = np.zeros(count, np.int32), np.ones(count, bool)
    else:
        labels = nearest(instance_id, samples[each, side % 3])              # (N, M)
        label, same = _common_label(labels, config.label_share)
    kept = fits[each, side % 3] & same & (ends > 0).all(axis=-1)
    kept &= inside(endpoints_px, depth_m.shape).all(axis=-1)
    depth_ends = np.where(kept[:, None], 1.0 / np.where(ends > 0, ends, 1.0), 0.0)
    return kept, np.where(kept, label, 0).astype(np.int32), depth_ends


_BOTH = 3   # stands for the mean of all three lines of samples; 3 % 3 = 0 is the segment itself


def _sample_positions(endpoints_px: Array, t: Array, side_px: float) -> Array:
    """(N, 3, M, 2): on the segment, to its one side, to its other side."""
    start, along = endpoints_px[:, 0], endpoints_px[:, 1] - endpoints_px[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length
    on = start[:, None] + t[:, None] * along[:, None]
    offset = side_px * np.array([0.0, 1.0, -1.0])
    return np.asarray(on[:, None] + (offset[None, :, None] * normal[:, None])[:, :, None])


def _tolerance(inverse: Array, config: SegmentConfig) -> Array:
    return config.relative_tolerance * np.abs(inverse) + 3.0 * config.inverse_depth_sigma


def _fit_inverse_depth(t: Array, inverse: Array, known: Array,
                       config: SegmentConfig) -> tuple[Array, Array]:
    """Robust straight lines in 1/z.

    Returns:
        Their values (..., 2) at t = 0 and 1, and whether enough of the samples follow (...).
    """
    ends = _median_line(t, inverse, known)
    for _ in range(2):
        fitted = ends[..., :1] * (1 - t) + ends[..., 1:] * t
        near = known & (np.abs(inverse - fitted) <= _tolerance(fitted, config))
        ends = _least_squares_line(t, inverse, near, ends)
    fitted = ends[..., :1] * (1 - t) + ends[..., 1:] * t
    near = known & (np.abs(inverse - fitted) <= _tolerance(fitted, config))
    return ends, near.mean(axis=-1) >= config.fitting_share


def _median_line(t: Array, inverse: Array, known: Array) -> Array:
    """Theil–Sen over pairs half a segment apart: values (..., 2) at t = 0 and 1."""
    half = len(t) // 2
    slope = (inverse[..., half:2 * half] - inverse[..., :half]) / (t[half] - t[0])
    both = known[..., half:2 * half] & known[..., :half]
    slope = _masked_median(slope, both)
    start = _masked_median(inverse - slope[..., None] * t, known)
    return np.stack([start, start + slope], axis=-1)


def _masked_median(values: Array, mask: Array) -> Array:
    """Lower median over the last axis of the masked values; 0 where there are none."""
    ordered = np.sort(np.where(mask, values, np.inf), axis=-1)
    middle = np.maximum(mask.sum(axis=-1) - 1, 0) // 2
    picked = np.take_along_axis(ordered, middle[..., None], -1)[..., 0]
    return np.where(mask.any(axis=-1), picked, 0.0)


def _least_squares_line(t: Array, values: Array, mask: Array, otherwise: Array) -> Array:
    """Values (..., 2) at t = 0 and 1 of the least-squares line through the masked values."""
    w = mask.astype(np.float64)
    n = w.sum(axis=-1)
    safe = np.maximum(n, 1.0)
    t_mean = (w * t).sum(axis=-1) / safe
    v_mean = (w * values).sum(axis=-1) / safe
    dt = t - t_mean[..., None]
    spread = (w * dt * dt).sum(axis=-1)
    determined = (n >= 3) & (spread > 1e-3)
    slope = (w * dt * values).sum(axis=-1) / np.where(determined, spread, 1.0)
    start = v_mean - slope * t_mean
    return np.where(determined[..., None], np.stack([start, start + slope], axis=-1), otherwise)


def _owning_side(line: Array, fits: Array, config: SegmentConfig) -> Array:
    """Which samples (N,) tell a segment's depth: 0, 1 or 2, or _BOTH where all three agree."""
    middle = line.mean(axis=-1)                                             # (N, 3)
    gap = np.abs(line[:, 1] - line[:, 2]).max(axis=-1)
    smooth = fits.all(axis=-1) & (gap <= 2 * _tolerance(middle.max(axis=-1), config))
    nearest_fit = np.argmax(np.where(fits, middle, -1.0), axis=-1)
    return np.where(smooth, _BOTH, nearest_fit)


def _common_label(labels: Array, share: float) -> tuple[Array, Array]:
    """The label (N,) of most of the samples (N, M), and whether it is both ends' and enough's."""
    middle = np.sort(labels, axis=-1)[:, labels.shape[-1] // 2]
    of_middle = labels == middle[:, None]
    return middle, (of_middle.mean(axis=-1) >= share) & of_middle[:, 0] & of_middle[:, -1]
