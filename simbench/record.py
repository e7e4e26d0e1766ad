"""All that happened in a run of a system over a feed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array
from slam.types import FrameEstimate, SlamResult, Status


@dataclass(frozen=True, slots=True)
class RunRecord:
    """All that happened in a run."""

    stamps_s: Array                               # (K,) of the frames run
    estimates: tuple[FrameEstimate, ...]          # K of them, as returned at the time
    true_of_label: tuple[Mapping[int, int], ...]  # K: mask label -> true object
    processed: Array                              # (K,) bool: `process` was given it and answered
    ms_per_frame: Array                           # (K,) inside `process`; NaN where it was not
    result: SlamResult | None                     # None: `finish` failed, or gave what it may not
    finish_s: float | None
    log: tuple[str, ...]                          # what went wrong, one entry each

    @property
    def one_frame(self) -> Array:
        """(K,) bool: the system also answered the frame before, so a motion spans one frame."""
        return np.concatenate([[False], self.processed[1:] & self.processed[:-1]])

    @property
    def lost(self) -> Array:
        """(K,) bool"""
        return np.array([e.status is Status.LOST for e in self.estimates], dtype=bool)
