"""One random generator for each stage and frame, so that adding a stage changes no other."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stage(IntEnum):
    """Spawn keys of the sensor stages; a number, once given, is never used for anything else."""

    DEPTH = 101
    RGB = 102
    FLOW = 103            # pairwise flow noise, by the frame the flow ends in
    LOCALISATION = 104    # where features are seen, by the frame they are seen in
    FLOW_TAIL = 105       # outliers of occluded pixels
    MASKS = 106
    LABELS = 107
    BOXES = 108
    RGB_RIGHT = 109       # the right camera of a stereo pair
    BOX_NOISE = 110
    BOX_DELAY = 111       # whether a frame's detections come a frame late


def generator(seed: int, stage: Stage, frame: int) -> np.random.Generator:
    """The generator of one stage in one frame: equal arguments draw equal numbers."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(stage), frame))
    return np.random.Generator(np.random.SFC64(sequence))
