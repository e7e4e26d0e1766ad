"""Instance masks from colour alone: saturated hues, cleaned by morphology."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slam.geometry.arrays import Array

_HUES = 180   # OpenCV's 8-bit hue: 2° a step


@dataclass(frozen=True, slots=True)
class HsvConfig:
    min_saturation: int = 110       # of 255
    min_value: int = 40             # of 255: darker pixels have no reliable hue
    hue_smoothing: float = 3.0      # σ over the histogram of hues, in steps of 2°
    hue_reach: int = 10             # pixels belong to a peak within this many steps
    open_px: int = 3                # specks smaller than this go
    close_px: int = 9               # gaps smaller than this are filled
    min_area: float = 0.0008        # share of the image; smaller regions go
    max_area: float = 0.5           # larger ones are the room


def hsv_masks(rgb: Array, config: HsvConfig | None = None) -> Array:
    """(H, W) int32 labels 1 … n of regions of one saturated hue; 0 elsewhere."""
    config = HsvConfig() if config is None else config
    hsv = cv2.cvtColor(cv2.medianBlur(np.ascontiguousarray(rgb), 5), cv2.COLOR_RGB2HSV)
    hue, saturation, value = cv2.split(hsv)
    coloured = (saturation >= config.min_saturation) & (value >= config.min_value)
    area = hue.size
    labels = np.zeros(hue.shape, np.int32)
    if np.count_nonzero(coloured) < config.min_area * area:
        return labels
    weight = np.bincount(hue[coloured], saturation[coloured] / 255.0, _HUES)
    peak_of_hue = _nearest_peak(_peaks(weight, config, area), config.hue_reach)
    cluster = np.where(coloured, peak_of_hue[hue], -1)
    found = 0
    for peak in range(int(peak_of_hue.max()) + 1):
        region = _cleaned((cluster == peak).astype(np.uint8), config)
        _, parts, stats, _ = cv2.connectedComponentsWithStats(region, connectivity=8)
        sizes = stats[:, cv2.CC_STAT_AREA]
        kept = (sizes >= config.min_area * area) & (sizes <= config.max_area * area)
        kept[0] = False
        number = np.where(kept, np.cumsum(kept) + found, 0).astype(np.int32)
        labels = np.where(labels == 0, number[parts], labels)
        found += int(np.count_nonzero(kept))
    return labels


def _peaks(weight: Array, config: HsvConfig, area: int) -> Array:
    """Hues (M,) at which the circular, smoothed histogram has a maximum worth an object."""
    reach = int(np.ceil(3 * config.hue_smoothing))
    kernel = cv2.getGaussianKernel(2 * reach + 1, config.hue_smoothing).ravel()
    smooth = np.convolve(np.pad(weight, reach, mode="wrap"), kernel, mode="valid")
    top = (smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1))
    near = np.convolve(np.pad(weight, config.hue_reach, mode="wrap"),
                       np.ones(2 * config.hue_reach + 1), mode="valid")
    return np.flatnonzero(top & (near >= config.min_area * area))


def _nearest_peak(peaks: Array, reach: int) -> Array:
    """(180,) index of the peak each hue belongs to; -1 when none is within reach."""
    if len(peaks) == 0:
        return np.full(_HUES, -1)
    gap = np.abs(np.arange(_HUES)[:, None] - peaks[None, :])
    gap = np.minimum(gap, _HUES - gap)
    best = np.argmin(gap, axis=1)
    return np.where(gap[np.arange(_HUES), best] <= reach, best, -1)


def _cleaned(region: Array, config: HsvConfig) -> Array:
    def ellipse(size: int) -> Array:
        return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))

    opened = cv2.morphologyEx(region, cv2.MORPH_OPEN, ellipse(config.open_px))
    return np.asarray(cv2.morphologyEx(opened, cv2.MORPH_CLOSE, ellipse(config.close_px)))
