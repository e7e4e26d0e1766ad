"""Truth of a real recording: poses, and masks where they bear true ids; no exact images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn

from simbench.errors import UserError
from simbench.types import FlowTruth, FrameTruth, SceneLayout, Trajectories, VisibleEdges
from slam.geometry.arrays import Array


@dataclass(frozen=True)
class RecordedTruth:
    """Poses are read when first asked for: finding who is seen when reads every mask."""

    name: str
    read_trajectories: Callable[[], Trajectories]
    read_instances: Callable[[int], Array | None]

    layout: SceneLayout | None = None
    has_images: bool = False

    @cached_property
    def trajectories(self) -> Trajectories:
        """True poses of camera and objects."""
        return self.read_trajectories()

    def frame(self, k: int) -> FrameTruth:
        """Raises UserError: a recording has no exact depth."""
        self._refuse("exact depth and parts")

    def flow(self, i: int, j: int) -> FlowTruth:
        """Raises UserError: a recording has no exact flow."""
        self._refuse("true flow")

    def edges(self, k: int) -> VisibleEdges:
        """Raises UserError: a recording has no 3D edges."""
        self._refuse("true 3D edges")

    def part_boxes(self) -> Array:
        """Raises UserError: nobody measured a recording's things."""
        self._refuse("true sizes of things")

    def true_instances(self, k: int) -> Array | None:
        """(H, W) int32 true object ids, or None where the recording has none."""
        return self.read_instances(k)

    def _refuse(self, what: str) -> NoReturn:
        raise UserError(f"{self.name}: a real recording has no {what}; "
                        "choose another input than truth")
