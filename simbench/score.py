"""Score what a system said against the truth: the blocks of metrics.json."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simbench.errors import UserError
from simbench.metrics.association import nearest_objects, owners
from simbench.metrics.camera import camera_metrics, camera_step_errors
from simbench.metrics.consistency import consistency_metrics
from simbench.metrics.efficiency import Bounds
from simbench.metrics.estimates import (
    CameraEstimates,
    ObjectMotions,
    batch_camera,
    batch_motions,
    online_camera,
    online_motions,
)
from simbench.metrics.lines import line_metrics
from simbench.metrics.loops import loop_metrics
from simbench.metrics.objects import ObjectErrors, object_errors, object_metrics
from simbench.metrics.timing import peak_rss_mb, timing_metrics
from simbench.record import RunRecord
from simbench.sequence import Sequence
from simbench.types import ObjectPoses, Trajectories
from slam.geometry.arrays import Array
from slam.types import SlamResult


@dataclass(frozen=True, slots=True)
class Online:
    """The estimates of a record as the metrics see them, and whose track is whose."""

    camera: CameraEstimates
    motions: ObjectMotions
    owner: dict[int, int]

    @classmethod
    def of(cls, record: RunRecord) -> Online:
        motions = online_motions(record.estimates, record.one_frame, record.true_of_label)
        return cls(online_camera(record.estimates, record.one_frame), motions,
                   owners(motions.track, motions.stands_on))

    def object_errors(self, truth: Trajectories, exact: bool) -> dict[int, ObjectErrors]:
        """Every true object with the errors of its scored motions."""
        return object_errors(self.motions, self.owner, self.camera, truth, exact)


def score(trajectories: Trajectories | None, record: RunRecord, *, exact: bool = True,
          bounds: Bounds | None = None) -> dict[str, Any]:
    """The metrics of a run, by the stable keys of metrics.json.

    Args:
        trajectories: the truth; None where nothing is known, and then there are no errors.
        exact: the truth is a simulator's, not a recording's.
        bounds: watched the run, where the noise of its inputs is known.
    """
    out: dict[str, Any] = {}
    if trajectories is not None:
        truth = truncated(trajectories, len(record.estimates))
        online = Online.of(record)
        out["camera"] = camera_metrics(online.camera, truth, exact)
        errors = online.object_errors(truth, exact)
        out["objects"] = object_metrics(errors, online.motions, online.owner, truth, exact)
        out["consistency"] = consistency_metrics(
            online.camera, camera_step_errors(online.camera, truth), online.motions, errors, truth,
            bounds)
        if record.result is not None:
            camera, motions = batch_of(record.result, record.stamps_s)
            out |= _batch_blocks(camera, motions, online.owner, truth, exact)
    if record.result is not None:
        out["lines"] = line_metrics(record.result)
        out["loops"] = loop_metrics(record.result, record.stamps_s, None if trajectories is None
                                    else truncated(trajectories, len(record.estimates)))
    done = record.processed
    out["timing"] = timing_metrics(
        record.ms_per_frame[done],
        [e.timings_ms for e, there in zip(record.estimates, done, strict=True) if there],
        record.finish_s) | {"peak_rss_mb": peak_rss_mb()}
    return {key: value for key, value in out.items() if value}


def evaluate(sequence: Sequence, result: SlamResult) -> dict[str, Any]:
    """The metrics of what `finish` returned, without knowing which label a track stood on.

    A track belongs to the true object nearest to its centroids.

    Raises:
        UserError: the sequence has no truth, or the result is of other frames.
    """
    if sequence.truth is None:
        raise UserError(f"{sequence.name}: has no truth to score against")
    truth = sequence.truth.trajectories
    try:
        camera, motions = batch_of(result, truth.stamps_s)
    except ValueError as error:
        raise UserError(f"{sequence.name}: not a result of this sequence: {error}") from None
    out = poses_and_motions_metrics(camera, motions, truth, sequence.truth.has_images)
    out["lines"] = line_metrics(result)
    out["loops"] = loop_metrics(result, truth.stamps_s, truth)
    return {key: value for key, value in out.items() if value}


def poses_and_motions_metrics(camera: CameraEstimates, motions: ObjectMotions,
                              truth: Trajectories, exact: bool) -> dict[str, Any]:
    """`camera` and `objects`, each track given to the true object nearest to its centroids."""
    motions = replace(motions, stands_on=nearest_objects(motions, truth))
    owner = owners(motions.track, motions.stands_on)
    errors = object_errors(motions, owner, camera, truth, exact)
    return {"camera": camera_metrics(camera, truth, exact),
            "objects": object_metrics(errors, motions, owner, truth, exact)}


def batch_of(result: SlamResult, stamps_s: Array) -> tuple[CameraEstimates, ObjectMotions]:
    """The camera and the object motions of `finish`. Raises ValueError as `batch_camera` does."""
    camera = batch_camera(result, stamps_s)
    return camera, batch_motions(result, camera)


def _batch_blocks(camera: CameraEstimates, motions: ObjectMotions, online_owner: dict[int, int],
                  truth: Trajectories, exact: bool) -> dict[str, Any]:
    """A track belongs to the object it stood on online; only new ones go to the nearest."""
    nearest = owners(motions.track, nearest_objects(motions, truth))
    owner = {track: online_owner.get(track, nearest[track]) for track in nearest}
    stands_on = np.array([owner[int(t)] for t in motions.track], dtype=np.int64)
    motions = replace(motions, stands_on=stands_on)
    errors = object_errors(motions, owner, camera, truth, exact)
    return {"camera_batch": camera_metrics(camera, truth, exact),
            "objects_batch": object_metrics(errors, motions, owner, truth, exact),
            "consistency_batch": consistency_metrics(
                camera, camera_step_errors(camera, truth), motions, errors, truth)}


def truncated(truth: Trajectories, count: int) -> Trajectories:
    """The first `count` frames of a truth."""
    if count >= len(truth.stamps_s):
        return truth
    objects = {i: ObjectPoses(o.T_world_object[:count], o.valid[:count], o.rigid, o.name)
               for i, o in truth.objects.items()}
    return Trajectories(truth.stamps_s[:count], truth.T_world_camera[:count],
                        truth.camera_valid[:count], objects)
