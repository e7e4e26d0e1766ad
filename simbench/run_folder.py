"""A run's folder: metrics.json, trajectories, report, settings and log, each written whole."""

from __future__ import annotations

import json
import logging
import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simbench.errors import BadFile
from simbench.metrics.estimates import CameraEstimates, ObjectMotions
from simbench.sequence import kind_of_folder
from simbench.trajectory_files import tum_lines
from simbench.untrusted import read_json_object
from slam.geometry import se3
from slam.geometry.arrays import Array

SCHEMA = 1
_RUNNING = "running\n"   # log.txt until the run is done
_SEQUENCE_FILES = ("sequence.json", "unfinished.json", "rgb.txt", "calib.txt")

log = logging.getLogger(__name__)


def prepare(folder: Path) -> None:
    """Make the folder and see that it can be written, before hours are spent on a run.

    A run that is there is overwritten, and the log says so.

    Raises:
        BadFile: a file stands in its place, or the folder is a sequence or holds other things.
        OSError: no permission, or no space.
    """
    if folder.exists() and not folder.is_dir():
        raise BadFile(f"{folder}: is a file, not a folder; choose another --out")
    if kind_of_folder(folder) or any((folder / name).exists() for name in _SEQUENCE_FILES):
        raise BadFile(f"{folder}: is a sequence, no place for a run; choose another --out")
    if not _is_begun(folder):
        if _is_run(folder):
            log.warning("%s: overwriting the run that is there", folder)
        elif folder.exists() and any(folder.iterdir()):
            raise BadFile(f"{folder}: holds files that are no run; choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "log.txt", _RUNNING)


def _is_begun(folder: Path) -> bool:
    """A run began here and has not ended: it goes on, or was killed."""
    try:
        return (folder / "log.txt").read_bytes() == _RUNNING.encode()
    except (FileNotFoundError, IsADirectoryError):
        return False


def _is_run(folder: Path) -> bool:
    """There are metrics of ours, of whatever schema."""
    try:
        metrics = read_json_object(folder / "metrics.json", "run it again")
    except BadFile:
        return False
    return {"schema", "system", "sequence"} <= metrics.keys()


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_run(folder: Path, *, metrics: Mapping[str, Any], stamps_s: Array,
              camera: CameraEstimates, motions: ObjectMotions, report_html: str | None,
              config: Mapping[str, Any], log: Sequence[str], map_ply: str | None = None) -> None:
    """Write a run's folder; metrics.json comes last, so that with it the run is complete.

    Args:
        camera, motions: the estimates that `camera` and `objects` of the metrics score.
        report_html: None leaves the report out.
        config: everything resolved, made `plain`.
        map_ply: the map, where the system has one.
    """
    texts: dict[str, str | None] = {
        "trajectory.txt": tum_lines(stamps_s[camera.pose_known],
                                    camera.T_world_camera[camera.pose_known]),
        "object_motions.txt": motion_lines(motions, stamps_s),
        "objects.txt": pose_lines(motions, stamps_s),
        "map.ply": map_ply,
        "report.html": report_html,
        "config.yaml": yaml.safe_dump(dict(config), sort_keys=False, allow_unicode=True),
        "log.txt": "".join(f"{entry.rstrip()}\n" for entry in log),
        "metrics.json": metrics_text(metrics)}
    for name, text in texts.items():
        if text is None:
            (folder / name).unlink(missing_ok=True)   # an earlier run's
        else:
            write_whole(folder / name, text)


def metrics_text(metrics: Mapping[str, Any]) -> str:
    """metrics.json. Raises ValueError when a value is NaN or infinite."""
    return json.dumps({"schema": SCHEMA, **metrics}, indent=1, ensure_ascii=False,
                      allow_nan=False) + "\n"


def read_metrics(folder: Path) -> dict[str, Any]:
    """The metrics of a run's folder.

    Raises:
        BadFile: no complete run is there, or it is of another schema.
    """
    path = folder / "metrics.json"
    if not path.is_file():
        raise BadFile(f"{path}: no such file; give the folder of a finished run")
    metrics = read_json_object(path, "run it again")
    if metrics.get("schema") != SCHEMA:
        raise BadFile(f"{path}: not of schema {SCHEMA}; run it again with this version")
    return metrics


def motion_lines(motions: ObjectMotions, stamps_s: Array) -> str:
    """Rows `stamp_previous stamp track cx cy cz` + 16 numbers of H, row by row."""
    return "".join(
        f"{stamps_s[k - 1]:.6f} {stamps_s[k]:.6f} {track} {_numbers(centroid)} "
        f"{_numbers(H.ravel())}\n"
        for k, track, centroid, H in zip(motions.frame, motions.track, motions.centroid_world,
                                         motions.H_world, strict=True))


def pose_lines(motions: ObjectMotions, stamps_s: Array) -> str:
    """Rows `stamp track tx ty tz qx qy qz qw` of each track, sorted by track.

    The poses are the motions chained from a frame put at the centroid of the track's first
    points. Where a track was not estimated for a while, its frame is put at the centroid again
    and keeps its rotation.
    """
    out = []
    for track in np.unique(motions.track):
        rows = np.flatnonzero(motions.track == track)
        pose, last = np.eye(4), -1
        for row in rows:
            k = int(motions.frame[row])
            if k - 1 != last:
                pose = se3.from_rotation_translation(pose[:3, :3], motions.centroid_world[row])
                out.append(_pose_line(stamps_s[k - 1], int(track), pose))
            pose, last = motions.H_world[row] @ pose, k
            out.append(_pose_line(stamps_s[k], int(track), pose))
    return "".join(out)


def _pose_line(stamp_s: float, track: int, T: Array) -> str:
    quaternion = se3.quaternion_from_rotation(T[:3, :3])
    return f"{stamp_s:.6f} {track} {_numbers(T[:3, 3])} {_numbers(quaternion)}\n"


def _numbers(values: Array) -> str:
    return " ".join(f"{x:.17g}" for x in values)


def plain(value: Any) -> Any:
    """The value with nothing in it but what YAML can hold: mappings, lists, numbers and text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    return str(value)
