"""Another program's estimates, scored, as a run's folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from simbench import run_folder
from simbench.errors import UserError
from simbench.external import read_camera, read_motions
from simbench.metrics.association import nearest_objects, owners
from simbench.metrics.estimates import (
    CameraEstimates,
    ObjectMotions,
    camera_from_poses,
    motions_of_rows,
)
from simbench.outcome import Outcome, head
from simbench.report.content import ReportContent
from simbench.report.page import render_report
from simbench.score import poses_and_motions_metrics
from simbench.sequence import Sequence as RecordedSequence
from simbench.versions import versions


def score_to_folder(sequence: RecordedSequence, trajectory: Path | None, objects: Path | None,
                    out: Path, *, system: str | None = None, log: Sequence[str] = (),
                    timing: Mapping[str, Any] | None = None) -> Outcome:
    """Score what another program estimated, and write the run's folder.

    Args:
        trajectory: None where it estimated nothing: every frame is lost.
        system: what metrics.json calls it; the trajectory file's name by default.
        log: what the program said.
        timing: how long it took and what memory it held, where that is known.
    Raises:
        UserError: the sequence has no truth.
        BadFile: a broken row in either file.
        OSError: the folder cannot be written.
    """
    if sequence.truth is None:
        raise UserError(f"{sequence.name}: has no truth to score against")
    stamps_s = np.asarray(sequence.stamps_s)
    camera, notes = _no_camera(len(stamps_s)) if trajectory is None \
        else read_camera(trajectory, stamps_s)
    motions, more = (_no_motions(camera), []) if objects is None \
        else read_motions(objects, stamps_s, camera)
    _check_not_inside(out, trajectory, objects)
    run_folder.prepare(out)
    truth, exact = sequence.truth.trajectories, sequence.truth.has_images
    blocks = poses_and_motions_metrics(camera, motions, truth, exact)
    if objects is None and trajectory is not None:
        del blocks["objects"]   # nobody estimated any: that is not a coverage of 0
    notes = [*log, *notes, *more]
    blocks["timing"] = timing or {}
    name = system or (trajectory.name if trajectory else "estimate")
    metrics = head(name, sequence, len(sequence)) \
        | {key: block for key, block in blocks.items() if block}
    config = run_folder.plain({
        "truth": sequence.name, "trajectory": trajectory, "objects": objects,
        "versions": versions()})
    owner = owners(motions.track, nearest_objects(motions, truth))
    content = ReportContent.of(metrics, stamps_s, camera, motions, owner, truth, exact, (),
                               config, notes)
    run_folder.write_run(out, metrics=metrics, stamps_s=stamps_s, camera=camera, motions=motions,
                         report_html=render_report(content), config=config, log=notes)
    return Outcome(metrics, tuple(notes), len(sequence),
                   int((~camera.pose_known).sum()))


def _check_not_inside(out: Path, *files: Path | None) -> None:
    """Estimates in `out` itself would be overwritten by the folder's own files of their names."""
    for path in files:
        if path is not None and path.resolve().parent == out.resolve():
            raise UserError(f"--out {out}: holds {path.name}, which is to be scored; "
                            "choose another --out")


def _no_camera(frames: int) -> tuple[CameraEstimates, list[str]]:
    known = np.zeros(frames, dtype=bool)
    return camera_from_poses(np.repeat(np.eye(4)[None], frames, axis=0), known), []


def _no_motions(camera: CameraEstimates) -> ObjectMotions:
    none = np.zeros(0, dtype=np.int64)
    return motions_of_rows(none, none, np.zeros((0, 4, 4)), np.zeros((0, 3)), camera)
