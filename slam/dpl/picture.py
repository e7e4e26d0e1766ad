"""A frame's picture as the stages of DPL-SLAM look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from slam.dpl.config import DepthConfig
from slam.frontend.refine import prepare_image
from slam.frontend.support import surface_image
from slam.geometry.arrays import Array
from slam.types import Frame


@dataclass(frozen=True)
class Picture:
    gray: Array          # (H, W) uint8
    depth_m: Array       # (H, W) float32, 0 where there is none

    @classmethod
    def of(cls, frame: Frame, config: DepthConfig) -> Picture:
        return cls(np.asarray(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)),
                   clean_depth(frame.depth_m, config))

    @classmethod
    def without_depth(cls, rgb: Array) -> Picture:
        gray = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))
        return cls(gray, np.zeros(gray.shape, np.float32))

    @cached_property
    def smooth(self) -> Array:
        """(H, W) float32 that patches are aligned on."""
        return prepare_image(self.gray)

    @cached_property
    def surface(self) -> Array:
        """(H, W) float32 that tells surfaces apart."""
        return surface_image(self.depth_m)

    @cached_property
    def rho(self) -> Array:
        """(H, W) float32 inverse depth, 0 where there is none."""
        known = self.depth_m > 0
        return np.divide(np.float32(1.0), self.depth_m, out=np.zeros_like(self.depth_m),
                         where=known)


def clean_depth(depth_m: Array, config: DepthConfig) -> Array:
    """Depth (H, W) with 0 wherever it is none: not finite, or too near to be one."""
    with np.errstate(invalid="ignore"):
        good = (depth_m >= config.min_m) & np.isfinite(depth_m)
    return np.where(good, depth_m, np.float32(0.0))
