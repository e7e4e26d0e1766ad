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
    unreadable: tuple[str, ...] = ()              # of each frame that could not be read, why
    faults: tuple[str, ...] = ()                  # of each frame the system failed on, why
    finish_fault: str = ""                        # why `result` is None

    @property
    def failed(self) -> bool:
        """The system failed on every frame it was given."""
        return len(self.faults) > 0 and not bool(self.processed.any())

    @property
    def one_frame(self) -> Array:
        """(K,) bool: a motion that ends here spans one frame: the one before was answered, too,
        and was not lost."""
        known = self.processed & ~self.lost
        return np.concatenate([[False], self.processed[1:] & known[:-1]])

    @property
    def lost(self) -> Array:
        """(K,) bool"""
        return np.array([e.status is Status.LOST for e in self.estimates], dtype=bool)
