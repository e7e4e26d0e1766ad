"""End-point error of optical flow."""

from __future__ import annotations

import numpy as np

from simbench.types import FlowTruth
from slam.geometry.arrays import Array
from slam.types import FlowField


def end_point_errors(flow: FlowField, truth: FlowTruth) -> Array:
    """(N,) pixels: ‖φ − φ_true‖ of every pixel seen in both frames at which flow is given."""
    seen = truth.valid & ~truth.occluded & ~truth.leaving
    given = np.isfinite(flow.flow_px).all(axis=-1)
    if flow.valid is not None:
        given &= flow.valid
    both = seen & given
    gap = flow.flow_px[both].astype(np.float64) - truth.flow_px[both]
    return np.asarray(np.linalg.norm(gap, axis=-1))
