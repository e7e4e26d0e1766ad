"""End-point error of optical flow."""

from __future__ import annotations

import numpy as np

from simbench.sequence import SequenceTruth
from simbench.types import FlowTruth
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, FrameEstimate


def end_point_errors(flow: FlowField, truth: FlowTruth) -> Array:
    """(N,) pixels: ‖φ − φ_true‖ of every pixel seen in both frames at which flow is given."""
    seen = truth.valid & ~truth.occluded & ~truth.leaving
    given = np.isfinite(flow.flow_px).all(axis=-1)
    if flow.valid is not None:
        given &= flow.valid
    both = seen & given
    gap = flow.flow_px[both].astype(np.float64) - truth.flow_px[both]
    return np.asarray(np.linalg.norm(gap, axis=-1))


class FlowErrors:
    """An observer of a run: the end-point error of the flow that came with its frames.

    Args:
        truth: exact truth, or None, and then there is nothing to measure.
    """

    def __init__(self, truth: SequenceTruth | None) -> None:
        self._truth, self._sum_px, self._count = truth, 0.0, 0

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        if self._truth is None or frame.flow is None or frame.index == 0:
            return
        errors = end_point_errors(frame.flow, self._truth.flow(frame.index - 1, frame.index))
        self._sum_px += float(errors.sum())
        self._count += len(errors)

    def metrics(self) -> dict[str, float]:
        """The `flow` block: the mean over all pixels of all frames; empty without any."""
        return {"epe": self._sum_px / self._count} if self._count else {}
