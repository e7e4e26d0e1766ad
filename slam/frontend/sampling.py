"""Values of images at sub-pixel positions, without mixing surfaces.

Pixel centres are at integer coordinates; `uv` is (u right, v down).
"""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array


def inside(uv_px: Array, shape: tuple[int, ...], margin_px: float = 0.0) -> Array:
    """(...) bool: which positions (..., 2) lie within an image (H, W, ...), by a margin."""
    u, v = uv_px[..., 0], uv_px[..., 1]
    return np.asarray((u >= margin_px) & (v >= margin_px)
                      & (u <= shape[1] - 1 - margin_px) & (v <= shape[0] - 1 - margin_px))


def nearest(image: Array, uv_px: Array) -> Array:
    """The pixels (..., C?) of an image (H, W, C?) nearest to positions (..., 2).

    Outside the image its border repeats; a position that is not finite reads the corner (0, 0).
    """
    height, width = image.shape[:2]
    safe = np.where(np.isfinite(uv_px), uv_px, 0.0)
    column = np.clip(np.rint(safe[..., 0]), 0, width - 1).astype(np.intp)
    row = np.clip(np.rint(safe[..., 1]), 0, height - 1).astype(np.intp)
    return np.asarray(image[row, column])


def neighbours(shape: tuple[int, ...], uv_px: Array) -> tuple[Array, Array]:
    """The 2×2 pixels around positions (N, 2) and their bilinear weights.

    Outside the image its border repeats.

    Returns:
        Flat indices (4, N) into an image (H, W), in the order (top left, top right, bottom left,
        bottom right), and weights (4, N) that sum to 1.
    """
    height, width = shape[:2]
    safe = np.where(np.isfinite(uv_px), uv_px, 0.0)
    u = np.clip(safe[:, 0], 0.0, width - 1.0)
    v = np.clip(safe[:, 1], 0.0, height - 1.0)
    left = np.minimum(u.astype(np.intp), max(width - 2, 0))
    top = np.minimum(v.astype(np.intp), max(height - 2, 0))
    a, b = u - left, v - top
    corner = top * width + left
    right, below = int(width > 1), width * int(height > 1)
    index = np.stack([corner, corner + right, corner + below, corner + below + right])
    weight = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    return index, weight


def bilinear(image: Array, uv_px: Array) -> Array:
    """Bilinear values (N,) or (N, C), float64, of an image (H, W) or (H, W, C) at (N, 2)."""
    index, weight = neighbours(image.shape, uv_px)
    flat = image.reshape(image.shape[0] * image.shape[1], *image.shape[2:])
    if image.ndim == 3:
        weight = weight[..., None]
    return np.asarray((flat[index] * weight).sum(axis=0))


def depth_at(depth_m: Array, uv_px: Array, relative_jump: float = 0.05) -> Array:
    """Depth (N,) in metres at positions (N, 2), 0 where it is unknown.

    On one surface it is bilinear in inverse depth, which is exact on planes. Where the 2×2
    neighbours differ by more than `relative_jump` or one has no depth, the nearest pixel counts
    alone, so that the two sides of a depth edge are never mixed.

    Args:
        depth_m: (H, W) z-depth, 0 or not finite where there is none.
        uv_px: (N, 2); outside the image the answer is 0.
        relative_jump: largest ratio minus one of the four depths on one surface; 5 % is more
            than a road seen from a car grows in one row at 40 m, and less than most borders.
    """
    index, weight = neighbours(depth_m.shape, uv_px)
    four = depth_m.reshape(-1)[index].astype(np.float64)
    known = np.isfinite(four) & (four > 0)
    four = np.where(known, four, 1.0)
    smooth = known.all(axis=0) & (four.max(axis=0) <= (1.0 + relative_jump) * four.min(axis=0))
    blended = 1.0 / (weight / four).sum(axis=0)
    best = np.argmax(weight, axis=0)[None]
    alone = np.where(np.take_along_axis(known, best, 0), np.take_along_axis(four, best, 0), 0.0)[0]
    return np.where(inside(uv_px, depth_m.shape), np.where(smooth, blended, alone), 0.0)
