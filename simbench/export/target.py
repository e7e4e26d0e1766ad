"""What all exporters ask first: an empty folder, depth in the sequence, and a scale for it."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from simbench import storage
from simbench.datasets.simbench_folder import SimbenchFolder
from simbench.datasets.tum import TumFolder
from simbench.errors import UserError
from simbench.sequence import Sequence

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
    deepest_m, usual_m = 0.0, 0.0
    for k in range(len(sequence)):
        # A frame of a simulated sequence would bring its flow along, which takes its time.
        depth_m = (exact or sequence).frame(k).depth_m
        measured = depth_m[depth_m > 0]
        if measured.size:
            deepest_m = max(deepest_m, float(measured.max()))
            usual_m = max(usual_m, float(np.quantile(measured, _KEPT_SHARE)))
    if deepest_m * storage.DEPTH_SCALES[-1] < 65534:
        return storage.depth_scale_for(deepest_m)
    scale = storage.depth_scale_for(usual_m)
    _log.warning("%s: depths beyond %.0f m do not fit in 16 bits and are written as 0, no "
                 "measurement", sequence.name, 65534 / scale)
    return scale
