"""The offset of a depth sensor's inverse depths, learnt while tracking.

A stereo rig whose disparities are off by a part of a pixel measures ρ − δ for every true ρ: near
and far points then disagree about how far the camera went, which tells δ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_TRUST = 0.25          # of the information that one frame states: its errors are not independent
_SIGNIFICANT = 5.0     # standard deviations from which an offset is believed
_SMALLEST = 3e-4       # 1/m: noise that is not symmetric in 1/z looks like a smaller one
_LARGEST = 0.01        # 1/m: 4 px of disparity on KITTI; beyond it something else is wrong


@dataclass(frozen=True, slots=True)
class DepthOffset:
    """What all frames so far say of δ, 1/m."""

    information: float = 0.0
    weighted: float = 0.0

    def observed(self, offset: float, sigma: float) -> DepthOffset:
        """With one frame's estimate more."""
        if not np.isfinite(sigma) or sigma <= 0.0:
            return self
        information = _TRUST / sigma**2
        return DepthOffset(self.information + information, self.weighted + information * offset)

    @property
    def value(self) -> float:
        """To be added to every measured inverse depth; 0 while it does not stand out."""
        if self.information == 0.0:
            return 0.0
        mean = self.weighted / self.information
        least = max(_SMALLEST, _SIGNIFICANT / np.sqrt(self.information))
        return mean if least < abs(mean) < _LARGEST else 0.0
