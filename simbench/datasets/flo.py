"""Middlebury .flo files: dense flow, two float32 per pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.errors import BadFrame
from simbench.untrusted import read_bytes
from slam.geometry.arrays import Array
from slam.types import FlowField

_MAGIC = np.float32(202021.25)
_UNKNOWN_PX = 1e9   # Middlebury's mark: anything larger is unknown


def read_flo(path: Path, width: int, height: int) -> FlowField:
    """The flow of a file, invalid where Middlebury calls it unknown. Raises BadFrame."""
    data = read_bytes(path, 8 * width * height + 4096, BadFrame, "flow file")
    if len(data) < 12 or np.frombuffer(data[:4], "<f4")[0] != _MAGIC:
        raise BadFrame(f"{path}: not a Middlebury .flo file; replace it")
    got_width, got_height = (int(n) for n in np.frombuffer(data[4:12], "<i4"))
    if (got_width, got_height) != (width, height):
        raise BadFrame(f"{path}: flow of {got_width}×{got_height} pixels, the calibration says "
                       f"{width}×{height}; replace the file")
    if len(data) < 12 + 8 * width * height:
        raise BadFrame(f"{path}: the flow file is truncated ({len(data)} bytes); copy it again")
    flow = np.frombuffer(data, "<f4", count=2 * width * height, offset=12)
    flow = flow.reshape(height, width, 2).astype(np.float32)
    valid = np.all(np.abs(flow) < _UNKNOWN_PX, axis=-1)   # False for NaN, too
    return FlowField(np.where(valid[..., None], flow, np.float32(0)), valid)


def flo_bytes(flow_px: Array) -> bytes:
    """Flow (H, W, 2) as the bytes of a .flo file."""
    height, width = flow_px.shape[:2]
    head = _MAGIC.astype("<f4").tobytes() + np.array([width, height], "<i4").tobytes()
    return head + np.ascontiguousarray(flow_px, dtype="<f4").tobytes()
