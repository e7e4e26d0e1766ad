"""What is measured frame by frame while a system runs, besides its motions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simbench.inputs import Feed
from simbench.metrics.culling import CullingErrors
from simbench.metrics.deforming import RigidFits
from simbench.metrics.efficiency import Bounds
from simbench.metrics.flow import FlowErrors
from simbench.run import Observer


class Measures:
    """Observers of a run over a feed.

    Flow, culling and deforming objects are measured where truth has images, the bound on a
    motion's error where the noise that the feed adds is known, too.
    """

    def __init__(self, feed: Feed) -> None:
        truth, noise = feed.sequence.truth, feed.gaussian_noise
        shown = truth if truth is not None and truth.has_images else None
        self.fits = RigidFits(shown)
        self.bounds = None if noise is None or truth is None else Bounds(truth, noise)
        self._flow, self._culling = FlowErrors(shown), CullingErrors(shown)

    @property
    def observers(self) -> list[Observer]:
        """For `run`."""
        every: list[Observer] = [self._flow, self._culling, self.fits]
        return every if self.bounds is None else [*every, self.bounds]

    def blocks(self) -> dict[str, Mapping[str, Any]]:
        """The blocks of metrics.json that they fill."""
        return {name: block for name, block in (("flow", self._flow.metrics()),
                                                ("culling", self._culling.metrics())) if block}
