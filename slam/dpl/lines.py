"""Segments with LBD descriptors, and their depth."""

from __future__ import annotations

import numpy as np

from slam.dpl.config import LineConfig
from slam.dpl.features import KeyLines, no_lines
from slam.dpl.lbd import describe_lines
from slam.frontend.sampling import nearest
from slam.frontend.segments import cull_segments, detect_segments
from slam.geometry.arrays import Array

_SIDE_PX = 2.5           # from a segment to the pixels that tell its brighter side


class LineDetector:
    """The longest segments of an image, described by line bands (LBD)."""

    def __init__(self, config: LineConfig) -> None:
        self.config = config

    def __call__(self, gray: Array, depth_m: Array | None = None) -> KeyLines:
        """The segments of an image (H, W) uint8; depth is fitted along each from (H, W), metres."""
        if not self.config.enabled:
            return no_lines()
        ends = detect_segments(gray, self.config.detector, self.config.min_length_px)
        ends = np.clip(ends, 0.0, [gray.shape[1] - 1.0, gray.shape[0] - 1.0])
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        ends = ends[np.sort(np.argsort(-length, kind="stable")[:self.config.count])]
        if not len(ends):
            return no_lines()
        ends = bright_side_left(ends, gray)
        depth = np.zeros((len(ends), 2))
        if depth_m is not None:
            # A segment over a border of depth, or on no surface, has no depth: it is matched only.
            depth = cull_segments(ends, depth_m)[2]
        return KeyLines(ends, describe_lines(gray, ends), depth)


def bright_side_left(ends: Array, gray: Array) -> Array:
    """Segments (L, 2, 2) turned so that the brighter side lies on their left.

    LBD tells a segment from its reverse; a detector's direction may change from frame to frame.
    """
    along = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    left = np.stack([along[:, 1], -along[:, 0]], axis=1) / length       # v grows downwards
    t = np.linspace(0.1, 0.9, 9)[:, None]
    on = ends[:, None, 0] + t * along[:, None]
    step = _SIDE_PX * left[:, None]
    brighter = nearest(gray, on + step).astype(np.int32) - nearest(gray, on - step)
    return np.where((brighter.sum(axis=1) < 0)[:, None, None], ends[:, ::-1], ends)
