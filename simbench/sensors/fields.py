"""Random fields over an image: white, or smooth with equal variance everywhere."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry.arrays import Array


def noise_field(rng: np.random.Generator, size: tuple[int, int], channels: int,
                correlation_px: float = 0.0) -> Array:
    """(H, W, channels) float32 noise of mean 0 and standard deviation 1.

    Args:
        size: H and W.
        correlation_px: σ of the Gaussian that smooths the noise; 0 leaves it white.
    """
    if correlation_px <= 0.0:
        return rng.standard_normal((*size, channels), dtype=np.float32)
    reach = int(np.ceil(3.0 * correlation_px))
    kernel = cv2.getGaussianKernel(2 * reach + 1, correlation_px, cv2.CV_32F)
    # White noise through a separable kernel k has the standard deviation Σ k². The margin is
    # cut off again, so that the variance does not change towards the border.
    kernel = kernel / np.sqrt(np.sum(kernel**2))
    white = rng.standard_normal((size[0] + 2 * reach, size[1] + 2 * reach, channels),
                                dtype=np.float32)
    smooth = cv2.sepFilter2D(white, -1, kernel, kernel).reshape(white.shape)
    return np.ascontiguousarray(smooth[reach:-reach, reach:-reach])
