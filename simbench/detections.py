"""The boxes that a system is given: true, noisy, or found by a detector of the user's."""

from __future__ import annotations

import logging
from pathlib import Path

from simbench.errors import UserError
from simbench.input_choice import InputChoice
from simbench.sensors.boxes import (
    BoxNoise,
    box_noise,
    boxes_of_masks,
    class_number,
    is_late,
    shuffled_boxes,
)
from simbench.sensors.streams import Stage, generator
from simbench.sequence import Sequence
from slam.dynamics.detection import UNKNOWN_CLASS, BadDetector, Detector, OnnxDetector
from slam.geometry.arrays import Array
from slam.types import Boxes2D

_log = logging.getLogger(__name__)


class Detections:
    """Boxes by frame. Things without a class that detectors know are never detected."""

    def __init__(self, sequence: Sequence, choice: InputChoice, noise: BoxNoise, seed: int) -> None:
        """
        Raises:
            UserError: the detector's file is missing, no network, or of another output.
        """
        self._sequence, self._kind, self._noise, self._seed = sequence, choice.boxes, noise, seed
        self._detector: Detector | None = None
        if choice.boxes == "detector" and choice.detector is not None:
            self._detector = load_detector(choice.detector)
        self._class_of = _classes(sequence) if choice.boxes in ("truth", "noisy") else None
        if choice.boxes == "noisy" and self._class_of == {}:
            _log.warning("%s has nothing of a class that detectors know: --boxes noisy gives false "
                         "boxes only", sequence.name)

    def __call__(self, rgb: Array, k: int) -> Boxes2D | None:
        """The boxes of frame k, None where there is nobody to detect anything."""
        if self._detector is not None:
            return self._detector(rgb)
        if self._kind == "truth" and self._class_of != {}:
            true = self._true(k)
            return None if true is None else shuffled_boxes(
                true, generator(self._seed, Stage.BOXES, k))
        if self._kind == "noisy":
            late = is_late(self._noise, generator(self._seed, Stage.BOX_DELAY, k))
            seen = self._noisy(max(k - 1, 0) if late else k)
            return None if seen is None else shuffled_boxes(
                seen, generator(self._seed, Stage.BOXES, k))
        return None

    def _noisy(self, k: int) -> Boxes2D | None:
        true = self._true(k)
        if true is None:
            return None
        i = self._sequence.intrinsics
        return box_noise(true, self._noise, (i.height, i.width),
                         generator(self._seed, Stage.BOX_NOISE, k))

    def _true(self, k: int) -> Boxes2D | None:
        truth = self._sequence.truth
        masks = None if truth is None else truth.true_instances(k)
        return None if masks is None else boxes_of_masks(masks, self._class_of)


def load_detector(path: str) -> Detector:
    """The user's network. Raises UserError: the file is missing, no network, or of another output.
    """
    try:
        return OnnxDetector(Path(path))
    except BadDetector as error:
        raise UserError(f"--detector {error}") from None


def _classes(sequence: Sequence) -> dict[int, int] | None:
    """True id → class number of what detectors know; None for a recording: all its masks."""
    layout = None if sequence.truth is None else sequence.truth.layout
    if layout is None:
        return None
    numbers = {each.instance_id: class_number(each.category) for each in layout.objects}
    return {i: number for i, number in numbers.items() if number != UNKNOWN_CLASS}
