"""What all exporters ask first: an empty folder, depth in the sequence, and a scale for it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from simbench.datasets.simbench_folder import SimbenchFolder
from simbench.datasets.tum import TumFolder
from simbench.errors import UserError
from simbench.sequence import Sequence

SCALES = (5000.0, 1000.0, 256.0, 100.0)   # PNG units per metre: 13, 65, 256 and 655 m
_KEPT_SHARE = 0.99      # of the measured depths, where no scale holds them all
_log = logging.getLogger(__name__)


def make_folder(out: Path) -> None:
    """Make the folder. Raises UserError when something is in it already."""
    out.mkdir(parents=True, exist_ok=True)
    if any(out.iterdir()):
        raise UserError(f"{out}: the folder is not empty; choose another --out")


def depth_scale_for(sequence: Sequence) -> float:
    """PNG units per metre: the recording's own, else the finest that holds its depths.

    Raises:
        UserError: the sequence holds no depth.
        BadFrame: a frame cannot be read.
    """
    if "depth" not in sequence.holds:
        raise UserError(f"{sequence.name}: it holds no depth, which this layout needs; "
                        "export a sequence with depth")
    if isinstance(sequence, SimbenchFolder | TumFolder):
        return sequence.calibration.depth_scale
    exact = sequence.truth if sequence.truth and sequence.truth.has_images else None
    reach_m, far = 0.0, False
    for k in range(len(sequence)):
        # A frame of a simulated sequence would bring its flow along, which takes its time.
        depth_m = (exact or sequence).frame(k).depth_m
        measured = depth_m[depth_m > 0]
        if measured.size:
            reach_m = max(reach_m, float(np.quantile(measured, _KEPT_SHARE)))
            far = far or float(measured.max()) * SCALES[-1] >= 65534.5
    scale = next((s for s in SCALES if reach_m * s < 65534), SCALES[-1])
    if far:
        _log.warning("%s: depths beyond %.0f m do not fit in 16 bits and are written as 0, no "
                     "measurement", sequence.name, 65534 / scale)
    return scale
