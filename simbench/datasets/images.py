"""Images of a frame: what cannot be read raises BadFrame, which names the path and what to do."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from simbench.datasets import png
from simbench.datasets.image_header import image_size
from simbench.errors import BadFrame
from simbench.untrusted import read_bytes
from slam.geometry.arrays import Array

_JPEG, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_NO_MEASUREMENT = 65535   # what some sensors write where they saw nothing


def _decode(path: Path, flags: int, width: int, height: int) -> Array:
    """(height, width, …); OpenCV would fill a truncated image with grey without a word."""
    data = read_bytes(path, 16 * width * height + 1_000_000, BadFrame, "image")
    if not data or (data.startswith(_JPEG) and _JPEG_END not in data[-64:]):
        raise _damaged(path, "truncated", data)
    if data.startswith(png.SIGNATURE):
        try:
            data = png.pixels_only(data)
        except ValueError as error:
            raise _damaged(path, str(error), data) from None
    size = image_size(data)
    if size is None:
        raise BadFrame(f"{path}: not an image of PNG or JPEG; replace it")
    if size != (width, height):
        raise BadFrame(f"{path}: {size[0]}×{size[1]} pixels, the calibration says "
                       f"{width}×{height}; replace the image or mend the calibration")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        image = None
    if image is None or image.shape[:2] != (height, width):
        raise BadFrame(f"{path}: not an image that OpenCV can read; replace it")
    return np.asarray(image)


def _damaged(path: Path, how: str, data: bytes) -> BadFrame:
    return BadFrame(f"{path}: the image is {how} ({len(data)} bytes); copy it again")


def read_colour(path: Path, width: int, height: int) -> Array:
    """(H, W, 3) uint8 RGB; grey images are repeated in all three channels. Raises BadFrame."""
    image = _decode(path, cv2.IMREAD_COLOR, width, height)
    return np.ascontiguousarray(image[..., ::-1])


def read_uint16(path: Path, width: int, height: int) -> Array:
    """(H, W) uint16 of a one-channel 16-bit image. Raises BadFrame."""
    image = _decode(path, cv2.IMREAD_UNCHANGED, width, height)
    if image.dtype != np.uint16 or image.ndim != 2:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise BadFrame(f"{path}: {image.dtype} with {channels} channels, wanted one 16-bit "
                       "channel; replace the image")
    return image


def read_depth(path: Path, width: int, height: int, units_per_metre: float) -> Array:
    """(H, W) float32 z-depth in metres; 0 where there is none. Raises BadFrame."""
    raw = read_uint16(path, width, height)
    return np.where(raw == _NO_MEASUREMENT, 0, raw).astype(np.float32) / np.float32(units_per_metre)


def read_disparity_as_depth(path: Path, width: int, height: int, units_per_pixel: float,
                            bf_px_m: float) -> Array:
    """(H, W) float32 z = bf / disparity in metres; 0 where there is none. Raises BadFrame."""
    raw = read_uint16(path, width, height)
    seen = (raw > 0) & (raw != _NO_MEASUREMENT)
    scale = np.float32(bf_px_m * units_per_pixel)
    return np.where(seen, scale / np.where(seen, raw, 1).astype(np.float32), np.float32(0))
