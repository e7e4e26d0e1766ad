"""Everything that a report is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from simbench.metrics.camera import MotionErrors, camera_step_errors
from simbench.metrics.estimates import CameraEstimates, ObjectMotions
from simbench.metrics.objects import ObjectErrors, object_errors
from simbench.report.filmstrip import Picture
from simbench.report.map_view import MapView, map_of
from simbench.types import Trajectories
from slam.geometry.arrays import Array
from slam.types import SlamResult


@dataclass(frozen=True, slots=True)
class ReportContent:
    """A run, scored: what the page shows."""

    metrics: Mapping[str, Any]
    stamps_s: Array                              # (K,)
    camera: CameraEstimates
    motions: ObjectMotions
    owner: Mapping[int, int]                     # track -> true object
    truth: Trajectories | None
    camera_errors: MotionErrors | None
    object_errors: Mapping[int, ObjectErrors]
    pictures: Sequence[Picture] = ()
    config: Mapping[str, Any] = field(default_factory=dict)
    log: Sequence[str] = ()
    map: MapView | None = None

    @classmethod
    def of(cls, metrics: Mapping[str, Any], stamps_s: Array, camera: CameraEstimates,
           motions: ObjectMotions, owner: Mapping[int, int], truth: Trajectories | None,
           exact: bool, pictures: Sequence[Picture] = (),
           config: Mapping[str, Any] | None = None, log: Sequence[str] = (),
           result: SlamResult | None = None) -> ReportContent:
        """Compute the errors of each frame; `truth` covers just the frames run."""
        seen = map_of(result, camera, truth)
        if truth is None:
            return cls(metrics, stamps_s, camera, motions, owner, None, None, {}, pictures,
                       config or {}, log, seen)
        return cls(metrics, stamps_s, camera, motions, owner, truth,
                   camera_step_errors(camera, truth),
                   object_errors(motions, owner, camera, truth, exact), pictures,
                   config or {}, log, seen)
