"""The aperture problem: how well the image itself fixes where a pixel is."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry.arrays import Array


def structure_sigmas(rgb: Array, window_px: float, reference_dn: float,
                     cap: float) -> tuple[Array, Array, Array]:
    """Relative uncertainty of every pixel's position along both axes of its structure tensor.

    The tensor J = G(window_px) * ∇I ∇Iᵀ has the eigenvalues λ₁ ≥ λ₂; a position matched by
    intensity has the covariance ∝ J⁻¹. σᵢ = √(reference_dn² / λᵢ), cut to [1, cap]: 1 at a
    corner whose gradient is `reference_dn` grey levels per pixel in every direction.

    Returns:
        (H, W) σ along the strongest gradient, (H, W) σ across it, and (H, W, 2) float32
        (cos 2α, sin 2α) of the gradient's direction α.
    """
    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY)
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.125)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.125)
    products = cv2.merge([gx * gx, gx * gy, gy * gy])
    jxx, jxy, jyy = cv2.split(cv2.GaussianBlur(products, (0, 0), window_px))
    mean, half = 0.5 * (jxx + jyy), 0.5 * (jxx - jyy)
    radius = cv2.magnitude(half, jxy)
    floor = np.float32(reference_dn**2 / cap**2)
    along = np.sqrt(reference_dn**2 / np.maximum(mean + radius, floor))
    across = np.sqrt(reference_dn**2 / np.maximum(mean - radius, floor))
    safe = np.maximum(radius, np.float32(1e-12))
    axis = np.stack([half / safe, jxy / safe], axis=-1)
    return np.maximum(along, 1.0), np.maximum(across, 1.0), axis


def follow_structure(white: Array, along: Array, across: Array, axis: Array) -> Array:
    """(H, W, 2) white noise turned into noise of the σ's and axes of `structure_sigmas`."""
    mean, half = 0.5 * (along + across), 0.5 * (along - across)
    diagonal, mixed = half * axis[..., 0], half * axis[..., 1]
    u, v = white[..., 0], white[..., 1]
    return np.stack([(mean + diagonal) * u + mixed * v, mixed * u + (mean - diagonal) * v], -1)
