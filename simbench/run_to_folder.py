"""A run from the system's name to its finished folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simbench import run_folder
from simbench.captured_log import captured_log
from simbench.content_hash import HashedFeed
from simbench.errors import BadFile
from simbench.inputs import Feed
from simbench.load_system import load_system
from simbench.measures import Measures
from simbench.metrics.deforming import rigid_fit_metrics
from simbench.outcome import Outcome, head
from simbench.ply import ply_text
from simbench.report.content import ReportContent
from simbench.report.filmstrip import Filmstrip
from simbench.report.page import render_report
from simbench.run import RunRecord, run, score
from simbench.score import Online, truncated
from simbench.versions import versions


def run_to_folder(system_name: str, feed: Feed, out: Path, *, settings: Sequence[str] = (),
                  command: Mapping[str, Any] | None = None,
                  progress: Callable[[int], None] | None = None,
                  log: Sequence[str] = (), report: bool = True) -> Outcome:
    """Run a system over a feed, score it, and write the run's folder.

    Args:
        settings: "stage.field=value" for the system's configuration.
        command: what else belongs into config.yaml, such as the scene and its dials.
        log: what was said before the run began.
        report: write report.html, which takes as long as some twenty frames.
    Raises:
        UserError: no such system or setting, or the system refuses this input.
        BadFile: no frame could be read; the run's folder has no metrics then.
        OSError: the folder cannot be written.
    """
    system, resolved = load_system(system_name, feed.intrinsics, settings)
    feed.leave_stereo_to(system)
    run_folder.prepare(out)
    given, measures, film = HashedFeed(feed), Measures(feed), Filmstrip(len(feed))
    with captured_log() as said:
        record = run(system, given, progress=progress,
                     observers=[*measures.observers, *([film] if report else [])])
        if len(record.unreadable) == len(feed):
            raise BadFile(f"{feed.sequence.name}: no frame could be read, first: "
                          f"{_first_unreadable(record)}")
        truth = feed.sequence.truth
        exact = truth is not None and truth.has_images
        trajectories = None if truth is None else truncated(truth.trajectories, len(feed))
        scores = score(trajectories, record, exact=exact, bounds=measures.bounds)
    entries = (*log, *said, *record.log)
    metrics = head(system_name, feed.sequence, len(feed)) | scores | measures.blocks()
    metrics["sequence"]["given_sha256"] = given.hexdigest()
    config = run_folder.plain({
        "system": system_name, **(command or {}), "seed": feed.seed, "frames": len(feed),
        "inputs": asdict(feed.choice), "settings": resolved,
        "intrinsics": asdict(feed.intrinsics), "versions": versions()})
    online = Online.of(record)
    content = ReportContent.of(metrics, record.stamps_s, online.camera, online.motions,
                               online.owner, trajectories, exact, film.pictures, config, entries,
                               record.result)
    if trajectories is not None:
        for key, block in rigid_fit_metrics(measures.fits.H_world, content.object_errors,
                                            online.motions, online.camera, trajectories).items():
            metrics["objects"][key] |= block
    run_folder.write_run(out, metrics=metrics, stamps_s=record.stamps_s, camera=online.camera,
                         motions=online.motions, config=config, log=entries,
                         report_html=render_report(content) if report else None,
                         map_ply=_map_of(record))
    return Outcome(metrics, entries, len(feed), int(record.lost.sum()), _warnings(record),
                   record.failure)


def _map_of(record: RunRecord) -> str | None:
    """The map that the system returned, as PLY."""
    result = record.result
    if result is None or (result.points_world is None and result.lines_world is None):
        return None
    points = np.zeros((0, 3)) if result.points_world is None else result.points_world
    lines = np.zeros((0, 2, 3)) if result.lines_world is None else result.lines_world
    return ply_text(points, lines)


def _warnings(record: RunRecord) -> tuple[str, ...]:
    out = []
    if record.unreadable:
        frames = "1 frame" if len(record.unreadable) == 1 else f"{len(record.unreadable)} frames"
        out.append(f"{frames} could not be read, first: {_first_unreadable(record)}")
    if record.finish_fault:
        out.append(record.finish_fault)
    return tuple(out)


def _first_unreadable(record: RunRecord) -> str:
    return next(iter(record.unreadable.values()))
