"""The offset of a depth sensor's inverse depths, learnt while tracking.

A stereo rig whose disparities are off by a part of a pixel measures ρ − δ for every true ρ: near
and far points then disagree about how far the camera went, which tells δ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array

_TRUST = 0.25          # of the information that one frame states: its errors are not independent
_SIGNIFICANT = 5.0     # standard deviations from which an offset is believed
_SMALLEST = 3e-4       # 1/m: noise that is not symmetric in 1/z looks like a smaller one
_FARTHEST = 1e-6       # 1/m: nothing is behind the horizon
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
    def mean(self) -> float:
        """What is likeliest so far, believed or not; 0 while nothing is known."""
        return self.weighted / self.information if self.information > 0.0 else 0.0

    @property
    def sigma(self) -> float:
        """Standard deviation of the mean; infinite while nothing is known."""
        return float(1.0 / np.sqrt(self.information)) if self.information > 0.0 else np.inf

    @property
    def value(self) -> float:
        """To be added to every measured inverse depth; 0 while it does not stand out."""
        least = max(_SMALLEST, _SIGNIFICANT * self.sigma)
        return self.mean if least < abs(self.mean) < _LARGEST else 0.0


def shifted_inverse(rho: Array, offset: float) -> Array:
    """Inverse depths with an offset, 1/m, added; what would lie behind the horizon is far."""
    return np.maximum(rho + rho.dtype.type(offset), rho.dtype.type(_FARTHEST))


def shifted_depth(depth_m: Array, offset: float) -> Array:
    """Depths, 0 where there is none, with an offset (1/m) added to the inverse of each."""
    if offset == 0.0:
        return depth_m
    known = depth_m > 0
    rho = np.divide(1.0, depth_m, out=np.ones_like(depth_m), where=known)
    return np.where(known, 1.0 / shifted_inverse(rho, offset), depth_m.dtype.type(0))
