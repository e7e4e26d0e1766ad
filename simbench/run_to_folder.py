"""A run from the system's name to its finished folder, and the same for another's estimates."""

from __future__ import annotations

import logging
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from simbench import run_folder
from simbench.content_hash import HashedFeed
from simbench.errors import UserError
from simbench.external import read_camera, read_motions
from simbench.inputs import Feed
from simbench.load_system import load_system
from simbench.metrics.association import nearest_objects, owners
from simbench.metrics.culling import CullingErrors
from simbench.metrics.deforming import RigidFits, rigid_fit_metrics
from simbench.metrics.efficiency import Bounds
from simbench.metrics.estimates import (
    CameraEstimates,
    ObjectMotions,
    camera_from_poses,
    motions_of_rows,
)
from simbench.metrics.flow import FlowErrors
from simbench.ply import ply_text
from simbench.report.content import ReportContent
from simbench.report.filmstrip import Filmstrip
from simbench.report.page import render_report
from simbench.run import Observer, RunRecord, run, score
from simbench.score import Online, poses_and_motions_metrics, truncated
from simbench.sequence import Sequence as RecordedSequence


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a command tells of a run."""

    metrics: Mapping[str, Any]
    log: tuple[str, ...]
    frames: int
    lost: int
    warnings: tuple[str, ...] = ()   # what to tell besides the tables
    failure: str = ""                # the system lost the whole run; why


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
        OSError: the folder cannot be written.
    """
    system, resolved = load_system(system_name, feed.intrinsics, settings)
    feed.leave_stereo_to(system)
    run_folder.prepare(out)
    truth = feed.sequence.truth
    exact = truth is not None and truth.has_images
    film = Filmstrip(len(feed))
    shown = truth if exact else None
    flow, culling, fits = FlowErrors(shown), CullingErrors(shown), RigidFits(shown)
    given, noise = HashedFeed(feed), feed.gaussian_noise
    bounds = None if noise is None or truth is None else Bounds(truth, noise)
    observers: list[Observer] = [flow, culling, fits]
    observers += [film] if report else []
    observers += [] if bounds is None else [bounds]
    with captured_log() as said:
        record = run(system, given, progress=progress, observers=observers)
        trajectories = None if truth is None else truncated(truth.trajectories, len(feed))
        scores = score(trajectories, record, exact=exact, bounds=bounds)
    entries = (*log, *said, *record.log)
    scores |= {name: block for name, block in (("flow", flow.metrics()),
                                               ("culling", culling.metrics())) if block}
    metrics = head(system_name, feed.sequence, len(feed)) | scores
    metrics["sequence"]["given_sha256"] = given.hexdigest()
    config = run_folder.plain({
        "system": system_name, **(command or {}), "seed": feed.seed, "frames": len(feed),
        "inputs": asdict(feed.choice), "settings": resolved,
        "intrinsics": asdict(feed.intrinsics), "versions": versions()})
    online = Online.of(record)
    content = ReportContent.of(metrics, record.stamps_s, online.camera, online.motions,
                               online.owner, trajectories, exact, film.pictures, config, entries)
    if trajectories is not None:
        for key, block in rigid_fit_metrics(fits.H_world, content.object_errors, online.motions,
                                            online.camera, trajectories).items():
            metrics["objects"][key] |= block
    run_folder.write_run(out, metrics=metrics, stamps_s=record.stamps_s, camera=online.camera,
                         motions=online.motions, config=config, log=entries,
                         report_html=render_report(content) if report else None,
                         map_ply=_map_of(record))
    return Outcome(metrics, entries, len(feed), int(record.lost.sum()), _warnings(record),
                   f"failed on every frame, first: {record.faults[0]}" if record.failed else "")


def _map_of(record: RunRecord) -> str | None:
    """The map that the system returned, as PLY."""
    result = record.result
    if result is None or (result.points_world is None and result.lines_world is None):
        return None
    points = np.zeros((0, 3)) if result.points_world is None else result.points_world
    lines = np.zeros((0, 2, 3)) if result.lines_world is None else result.lines_world
    return ply_text(points, lines)


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


def _warnings(record: RunRecord) -> tuple[str, ...]:
    out = []
    if record.unreadable:
        frames = "1 frame" if len(record.unreadable) == 1 else f"{len(record.unreadable)} frames"
        out.append(f"{frames} could not be read, first: {record.unreadable[0]}")
    if record.finish_fault:
        out.append(record.finish_fault)
    return tuple(out)


def _check_not_inside(out: Path, *files: Path | None) -> None:
    """Estimates in `out` itself would be overwritten by the folder's own files of their names."""
    for path in files:
        if path is not None and path.resolve().parent == out.resolve():
            raise UserError(f"--out {out}: holds {path.name}, which is to be scored; "
                            "choose another --out")


def head(system: str, sequence: RecordedSequence, frames: int) -> dict[str, Any]:
    """What metrics.json says of the run itself."""
    return {"system": system, "sequence": {"name": sequence.name, "frames": frames,
                                           "sha256": sequence.fingerprint()}}


@cache
def versions() -> dict[str, str]:
    """Of what the numbers may depend on."""
    names = ("simbench-slam", "numpy", "scipy", "opencv-contrib-python-headless", "mujoco")
    found = {name: metadata.version(name) for name in names if _installed(name)}
    return {"python": platform.python_version()} | found


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def _no_camera(frames: int) -> tuple[CameraEstimates, list[str]]:
    known = np.zeros(frames, dtype=bool)
    return camera_from_poses(np.repeat(np.eye(4)[None], frames, axis=0), known), []


def _no_motions(camera: CameraEstimates) -> ObjectMotions:
    none = np.zeros(0, dtype=np.int64)
    return motions_of_rows(none, none, np.zeros((0, 4, 4)), np.zeros((0, 3)), camera)


@contextmanager
def captured_log() -> Iterator[list[str]]:
    """The warnings that our modules log meanwhile, each once."""
    said: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            entry = f"{record.levelname.lower()}: {record.getMessage()}"
            if entry not in said:
                said.append(entry)

    handler = Collector(logging.WARNING)
    loggers = [logging.getLogger(name) for name in ("simbench", "slam")]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield said
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


__all__ = ["Outcome", "RunRecord", "captured_log", "run_to_folder", "score_to_folder"]
