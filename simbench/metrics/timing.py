"""How long the system took and how much memory the process held."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from slam.geometry.arrays import Array


def timing_metrics(ms_per_frame: Array, stages_ms: Sequence[Mapping[str, float]],
                   finish_s: float | None) -> dict[str, Any]:
    """The `timing` block.

    Args:
        ms_per_frame: (N,) milliseconds inside `process`, of the frames it answered, in order. The
            first compiles and fills caches: it stands apart, and is in no other figure.
        stages_ms: the stages each of these frames named; a stage is averaged over the frames
            that name it.
        finish_s: seconds inside `finish`; None where it failed.
    """
    out: dict[str, Any] = {}
    if len(ms_per_frame):
        out["ms_first_frame"] = float(ms_per_frame[0])
    later_ms, later_stages_ms = ms_per_frame[1:], stages_ms[1:]
    if len(later_ms):
        out |= {"ms_per_frame_mean": float(np.mean(later_ms)),
                "ms_per_frame_median": float(np.median(later_ms)),
                "ms_per_frame_p95": float(np.percentile(later_ms, 95))}
    names = dict.fromkeys(name for frame in later_stages_ms for name in frame)
    stages = {name: float(np.mean([frame[name] for frame in later_stages_ms if name in frame]))
              for name in names}
    if stages:
        out["stages_ms"] = stages
    if finish_s is not None:
        out["batch_global_s"] = finish_s
    return out


def peak_rss_mb() -> float:
    """The most memory this process has held since it began, rendering included."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2 ** 20 if sys.platform == "darwin" else 2 ** 10)
