"""A frame's picture as the stages of DPL-SLAM look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numba
import numpy as np

from slam.dpl.config import DepthConfig
from slam.estimation.calibration import shifted_depth
from slam.frontend.refine import prepare_image
from slam.frontend.support import surface_image
from slam.geometry.arrays import Array
from slam.types import Frame


@dataclass(frozen=True)
class Picture:
    gray: Array          # (H, W) uint8
    depth_m: Array       # (H, W) float32, 0 where there is none
    depth_offset: float = 0.0    # 1/m, that all inverse depths are given

    @classmethod
    def of(cls, frame: Frame, config: DepthConfig, depth_offset: float) -> Picture:
        depth = shifted_depth(clean_depth(frame.depth_m, config), depth_offset)
        return cls(np.asarray(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)), depth, depth_offset)

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
    return np.asarray(_between(np.asarray(depth_m, np.float32), np.float32(config.min_m)))


@numba.njit(cache=True, nogil=True)
def _between(depth, least):  # type: ignore[no-untyped-def]
    """The values from `least` on that are finite; 0 for the others."""
    out = np.zeros_like(depth)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if least <= depth[v, u] < np.inf:
                out[v, u] = depth[v, u]
    return out
