"""How long static lines live (SDPL-SLAM Table I)."""

from __future__ import annotations

from slam.types import SlamResult


def line_metrics(result: SlamResult) -> dict[str, float]:
    """The mean number of frames that a static line tracklet lived; empty without lines."""
    lengths = result.static_line_tracklet_lengths
    if lengths is None or not len(lengths):
        return {}
    return {"static_tracklet_length": float(lengths.mean())}
