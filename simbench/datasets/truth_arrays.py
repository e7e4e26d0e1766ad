"""Arrays of truth.zarr, read with their sizes known beforehand.

What `storage` writes: Zarr 3, little-endian, one zstd frame for each chunk. A stranger's file may
claim anything else, such as shapes that fill the memory or codecs that run code; it is refused by
its description, before a byte of it is decoded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numcodecs.zstd import Zstd

from simbench.errors import BadFile, BadFrame, UserError
from simbench.stated import items, whole
from simbench.untrusted import read_bytes, read_json_object
from slam.geometry.arrays import Array

_DTYPES = {"float64": "<f8", "float32": "<f4", "int64": "<i8", "int32": "<i4", "int16": "<i2"}
_MOST_BYTES = 2_000_000_000         # of one chunk
_MOST_DESCRIPTION = 100_000
_MOST_LONG = 2**40
_AGAIN = "generate the sequence again"
_ZSTD = b"\x28\xb5\x2f\xfd"


class TruthArray:
    """One array: whole in one chunk, or a chunk for each frame."""

    def __init__(self, folder: Path, name: str, per_frame: bool = False) -> None:
        """Read the description. Raises BadFile when it is missing or not what we write."""
        self.path = folder / name
        about = read_json_object(self.path / "zarr.json", _AGAIN, _MOST_DESCRIPTION)
        try:
            self.shape, self.dtype, chunk = _described(about)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise BadFile(f"{self.path}/zarr.json: not an array as simbench writes it "
                          f"({type(error).__name__}: {error}); {_AGAIN}") from None
        whole = tuple(max(1, n) for n in self.shape)
        self._chunk = (1, *whole[1:]) if per_frame else whole
        if chunk != self._chunk:
            raise BadFile(f"{self.path}/zarr.json: chunks of {chunk}, wanted {self._chunk}; "
                          f"{_AGAIN}")

    def whole(self) -> Array:
        """All of it. Raises BadFile when its chunk is missing or damaged."""
        if 0 in self.shape:
            return np.zeros(self.shape, self.dtype)
        return self._decoded([0] * len(self.shape), BadFile).reshape(self.shape)

    def frame(self, k: int) -> Array:
        """What it holds of frame k. Raises BadFrame when the chunk is missing or damaged."""
        if 0 in self.shape[1:]:
            return np.zeros(self.shape[1:], self.dtype)
        return self._decoded([k] + [0] * (len(self.shape) - 1), BadFrame)[0]

    def _decoded(self, index: list[int], error: type[UserError]) -> Array:
        path = self.path.joinpath("c", *map(str, index))
        out = np.empty(self._chunk, self.dtype)
        data = read_bytes(path, out.nbytes + out.nbytes // 100 + 1024, error)
        damaged = error(f"{path}: truncated or damaged; {_AGAIN}")
        if _content_size(data) != out.nbytes:
            raise damaged
        try:
            Zstd().decode(data, out=out)
        except (ValueError, RuntimeError):
            raise damaged from None
        return out


def _content_size(data: bytes) -> int | None:
    """How many bytes a zstd frame says that it holds (RFC 8878, 3.1.1.1); None if it does not."""
    if len(data) < 6 or not data.startswith(_ZSTD):
        return None
    flags = data[4]
    single = bool(flags & 0x20)
    at = 5 + (not single) + (0, 1, 2, 4)[flags & 3]
    length = (1 if single else 0, 2, 4, 8)[flags >> 6]
    if not length or len(data) < at + length:
        return None
    return int.from_bytes(data[at:at + length], "little") + (256 if length == 2 else 0)


def _described(about: Mapping[str, Any]) -> tuple[tuple[int, ...], str, tuple[int, ...]]:
    """Shape, dtype and chunk shape of a description. Raises ValueError and its like."""
    grid = about["chunk_grid"]
    shape, chunk = (tuple(whole(n, key, 0, _MOST_LONG) for n in items(numbers, key))
                    for key, numbers in (("shape", about["shape"]),
                                         ("chunk_shape", grid["configuration"]["chunk_shape"])))
    codecs = [codec["name"] for codec in about["codecs"]]
    if (about["zarr_format"], about["node_type"], grid["name"]) != (3, "array", "regular") \
            or codecs != ["bytes", "zstd"] \
            or about["codecs"][0].get("configuration", {}).get("endian", "little") != "little":
        raise ValueError("another format")
    if len(shape) != len(chunk) or not shape or min(chunk) < 1:
        raise ValueError(f"shape {shape} in chunks of {chunk}")
    dtype = _DTYPES[about["data_type"]]
    if math.prod(chunk) * np.dtype(dtype).itemsize > _MOST_BYTES:
        raise ValueError(f"chunks of {chunk} {about['data_type']} are too large")
    return shape, dtype, chunk
