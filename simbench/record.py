"""All that happened in a run of a system over a feed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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
    unreadable: Mapping[int, str] = field(default_factory=dict)   # frames nobody could read: why
    finish_fault: str = ""                        # why `result` is None

    @property
    def failure(self) -> str:
        """Why the whole run is lost, or "": the system was given frames and followed none.

        The first frame it is given says nothing: any pose would do there.
        """
        given = [e for k, e in enumerate(self.estimates) if k not in self.unreadable]
        lost = [e for e in given if e.status is Status.LOST]
        followed = [e for e in given[1:] or given if e.status is not Status.LOST]
        if followed or not lost:
            return ""
        which = "every frame" if len(lost) == len(given) else "every frame after the first"
        return f"lost {which} (frame {lost[0].index}: {lost[0].reason or 'no reason given'})"

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
