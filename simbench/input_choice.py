"""Which inputs a system is to get, and which of them a sequence can give."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

from simbench.errors import BadFrame, UserError
from simbench.sequence import Sequence, SequenceTruth
from slam.geometry.arrays import Array

log = logging.getLogger(__name__)

CHOICES: Mapping[str, tuple[str, ...]] = {
    "flow": ("truth", "noisy", "dis", "given"),
    "masks": ("truth", "noisy", "given", "hsv", "none"),
    "boxes": ("truth", "noisy", "detector", "given", "none"),
    "depth": ("truth", "sensor", "stereo", "given"),
}


@dataclass(frozen=True, slots=True)
class InputChoice:
    """The inputs asked for; None takes what the sequence holds."""

    flow: str | None = None             # dis: the system computes it from the images
    masks: str | None = None
    boxes: str | None = None
    detector: str | None = None         # ONNX weights of a COCO detector, for boxes="detector"
    depth: str | None = None
    sensor: str | None = None           # None: colour and depth as recorded
    sensor_settings: Mapping[str, Any] = field(default_factory=dict)   # "depth.max_m": 5.0
    flow_sigma_px: float | None = None  # these three replace the sensor's flow noise
    flow_noise_kind: str | None = None  # pairwise, localisation
    flow_noise_shape: str | None = None # isotropic, structure
    shuffle_labels: bool = True         # so that a system really has to associate masks

    def __post_init__(self) -> None:
        for name, known in CHOICES.items():
            value = getattr(self, name)
            if value is not None and value not in known:
                raise UserError(f"--{name} {value}: wanted one of {', '.join(known)}")
        if self.detector is not None and self.boxes is None:
            object.__setattr__(self, "boxes", "detector")
        if (self.boxes == "detector") != (self.detector is not None):
            raise UserError("--boxes detector: give the weights of a COCO detector with --detector "
                            "FILE.onnx" if self.detector is None else
                            f"--detector {self.detector}: --boxes {self.boxes} leaves it unused")


@runtime_checkable
class Rendered(Protocol):
    """A sequence whose pictures are made as they are asked for: it can show what lies between."""

    def rgb(self, k: int) -> Array: ...
    def render_blurred(self, k: int, exposure_s: float, subframes: int) -> Array: ...


def resolve_choice(choice: InputChoice, sequence: Sequence) -> InputChoice:
    """The choice with everything named that was left open, and fallbacks taken.

    `given` of something that the recording lacks becomes `dis` or `none`, and the log says so.
    Raises:
        UserError: truth, a sensor or stereo was asked for where the sequence has none.
    """
    exact = sequence.truth is not None and sequence.truth.has_images
    named = _with_defaults(choice, sequence.holds, exact)
    if not exact:
        _check_without_images(named, sequence.name)
    if {"truth", "noisy"} & {named.masks, named.boxes} and not _knows_masks(sequence.truth):
        option = "masks" if named.masks in ("truth", "noisy") else "boxes"
        raise UserError(f"--{option} {getattr(named, option)}: {sequence.name} has no true masks; "
                        f"use --{option} given or none")
    _check_depth(named, sequence)
    return replace(named, depth=_as_rendered(named.depth, sequence),
                   flow=_fallback("flow", named.flow, "dis", sequence),
                   masks=_fallback("masks", named.masks, "none", sequence),
                   boxes=_fallback("boxes", named.boxes, "none", sequence))


def _with_defaults(choice: InputChoice, holds: frozenset[str], exact: bool) -> InputChoice:
    if choice.sensor is not None and exact:
        depth = "sensor"
    elif "stereo" in holds and "depth" not in holds:
        depth = "stereo"
    else:
        depth = "given" if "depth" in holds or not exact else "truth"
    return replace(
        choice, depth=choice.depth or depth,
        flow=choice.flow or ("given" if "flow" in holds else "dis"),
        masks=choice.masks or ("given" if "masks" in holds else "truth" if exact else "none"),
        boxes=choice.boxes or ("given" if "boxes" in holds else "truth" if exact else "none"))


def _check_without_images(choice: InputChoice, name: str) -> None:
    for option, value, instead in (("flow", choice.flow, "dis"), ("depth", choice.depth, "given")):
        if value in ("truth", "noisy", "sensor"):
            raise UserError(f"--{option} {value}: {name} has no exact truth images; "
                            f"use --{option} {instead}")
    if choice.sensor is not None:
        raise UserError(f"--sensor {choice.sensor}: {name} is a recording, its sensor has "
                        "already acted; leave --sensor out")


def _check_depth(choice: InputChoice, sequence: Sequence) -> None:
    if choice.depth == "stereo" and "stereo" not in sequence.holds:
        raise UserError(f"--depth stereo: {sequence.name} has no right images; "
                        "generate it with --stereo, or use --depth given")
    if choice.depth == "given" and "depth" not in sequence.holds:
        instead = ("use --depth stereo" if "stereo" in sequence.holds else
                   "it needs depth images or a right camera")
        raise UserError(f"--depth given: {sequence.name} holds no depth; {instead}")


def _knows_masks(truth: SequenceTruth | None) -> bool:
    try:
        return truth is not None and truth.true_instances(0) is not None
    except BadFrame:       # there is a mask; that it cannot be read is said when its turn comes
        return True


def _as_rendered(value: str | None, sequence: Sequence) -> str | None:
    """What a sequence gives that is rendered as it is asked for is the truth."""
    return "truth" if value == "given" and isinstance(sequence, Rendered) else value


def _fallback(option: str, value: str | None, instead: str,
              sequence: Sequence) -> str | None:
    if value != "given" or option in sequence.holds:
        return _as_rendered(value, sequence)
    log.warning("%s holds no %s: --%s given falls back to %s", sequence.name, option, option,
                instead)
    return instead
