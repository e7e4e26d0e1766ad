"""Sequences and runs in the Rerun viewer, or in a file that it opens."""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from simbench.datasets.rows import read_numbers
from simbench.errors import UserError
from simbench.extras import how_to_install
from simbench.ply import read_ply
from simbench.sequence import Sequence
from simbench.trajectory_files import read_tum_trajectory
from simbench.types import Trajectories
from simbench.view.pictures import Scale, flow_picture, flow_px_of, labels_of
from simbench.view.sheet import check_place
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame

_TRUE, _ESTIMATED, _LINES = (60, 160, 60), (220, 60, 40), (40, 90, 220)     # RGB
# Radii below 0 are in pixels of the viewer.
_MAP_POINT_PX, _OBJECT_PX = -1.5, -4.0


def record_sequence(sequence: Sequence, save: Path | None = None) -> None:
    """Show frames, masks, flow, true edges and true paths in the viewer, or save them as .rrd.

    Raises:
        UserError: Rerun is not installed, or there is no place for the file, or no display for
            the viewer.
        BadFrame: a frame cannot be read.
    """
    recording = _Recording(save)
    recording.sequence(sequence, np.eye(4))
    recording.close()


def record_run(folder: Path, sequence: Sequence | None, save: Path | None = None) -> None:
    """Show a run's estimated paths and map; with its sequence, beside frames and truth.

    The truth is moved so that its first camera stands on the first estimated one.

    Args:
        sequence: what the run was made on; None where that is not at hand.
    Raises:
        UserError: Rerun is not installed, or there is no place for the file.
        BadFile: trajectory.txt, objects.txt or map.ply is missing or broken.
        BadFrame: a frame cannot be read.
    """
    stamps_s, T = read_tum_trajectory(folder / "trajectory.txt")
    objects = read_numbers(folder / "objects.txt", 9, "t track tx ty tz qx qy qz qw")
    points, lines = read_ply(folder / "map.ply") if (folder / "map.ply").exists() \
        else (np.zeros((0, 3)), np.zeros((0, 2, 3)))
    recording = _Recording(save)
    recording.map(points, lines)
    if sequence is not None:
        recording.sequence(sequence, _onto(sequence, stamps_s, T))
    recording.estimate(stamps_s, T, objects)
    recording.close()


def _onto(sequence: Sequence, stamps_s: Array, T_estimate_camera: Array) -> Array:
    """(4, 4) from the truth's world to the estimate's: the first common camera pose is the same."""
    truth = None if sequence.truth is None else sequence.truth.trajectories
    if truth is None or len(stamps_s) == 0:
        return np.eye(4)
    nearest = np.abs(truth.stamps_s[:, None] - stamps_s).argmin(axis=1)
    common = truth.camera_valid & (np.abs(truth.stamps_s - stamps_s[nearest]) < 1e-3)
    if not np.any(common):
        return np.eye(4)
    k = int(np.argmax(common))
    return T_estimate_camera[nearest[k]] @ se3.inverse(truth.T_world_camera[k])


def _has_display() -> bool:
    return sys.platform != "linux" or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


class _Recording:
    """A Rerun recording: in a viewer that is started, or in a file."""

    def __init__(self, save: Path | None) -> None:
        if importlib.util.find_spec("rerun") is None:
            raise UserError(f"Rerun is not installed; {how_to_install('view')}; or give "
                            "--contact-sheet FILE.png or --mp4 FILE.mp4")
        import rerun  # noqa: PLC0415 (an optional extra)
        if save is not None:
            check_place("--save", save, (".rrd",))
        elif not _has_display():     # the viewer would end at once, and its data wait for it
            raise UserError("there is no display for Rerun's viewer; give --save FILE.rrd, "
                            "--contact-sheet FILE.png or --mp4 FILE.mp4")
        self._rr: Any = rerun
        self._stream = rerun.RecordingStream("simbench")
        if save is None:
            self._stream.spawn()
        else:
            self._stream.save(save)
        self._log("world", rerun.ViewCoordinates.RDF, static=True)

    def close(self) -> None:
        """Everything logged has reached the viewer or the file."""
        self._stream.flush()
        self._stream.disconnect()

    def sequence(self, sequence: Sequence, T_shown_world: Array) -> None:
        """Frames with what is true of them, the world moved by (4, 4)."""
        rr, i = self._rr, sequence.intrinsics
        truth = None if sequence.truth is None else sequence.truth.trajectories
        self._log("world/truth", self._transform(T_shown_world), static=True)
        self._log("world/truth/camera", rr.Pinhole(
            image_from_camera=i.matrix, width=i.width, height=i.height), static=True)
        if truth is not None:
            self._true_paths(truth)
        scale = Scale.of(sequence, sequence.frame(min(1, len(sequence) - 1)))
        for k in range(len(sequence)):
            frame = sequence.frame(k)
            self._stream.set_time("frame", sequence=k)
            self._stream.set_time("stamp", duration=frame.stamp_s)
            self._frame(sequence, frame, scale)
            if truth is not None:
                self._true_poses(truth, k)

    def _frame(self, sequence: Sequence, frame: Frame, scale: Scale) -> None:
        rr, camera = self._rr, "world/truth/camera"
        self._log(f"{camera}/rgb", rr.Image(frame.rgb))
        if "depth" in sequence.holds:
            self._log(f"{camera}/depth", rr.DepthImage(frame.depth_m, meter=1.0))
        labels, flow_px = labels_of(sequence, frame), flow_px_of(sequence, frame)
        if labels is not None:
            self._log(f"{camera}/masks", rr.SegmentationImage(labels.astype(np.uint16)))
        if flow_px is not None:
            self._log("flow", rr.Image(flow_picture(flow_px, max(scale.longest_px, 1e-3))))
        truth = sequence.truth
        if truth is not None and truth.has_images:
            edges = truth.edges(frame.index).endpoints_camera
            T = truth.trajectories.T_world_camera[frame.index]
            self._log("world/truth/edges", rr.LineStrips3D(
                se3.transform_points(T, edges.reshape(-1, 3)).reshape(-1, 2, 3), colors=[_LINES]))

    def _true_paths(self, truth: Trajectories) -> None:
        known = truth.T_world_camera[truth.camera_valid]
        self._path("world/truth/camera_path", known[:, :3, 3], _TRUE)
        for number, poses in truth.objects.items():
            self._path(_object("truth", poses.name or str(number)),
                       poses.T_world_object[poses.valid, :3, 3], _TRUE)

    def _true_poses(self, truth: Trajectories, k: int) -> None:
        if truth.camera_valid[k]:
            self._log("world/truth/camera", self._transform(truth.T_world_camera[k]))
        for number, poses in truth.objects.items():
            if poses.valid[k]:
                self._place(_object("truth", poses.name or str(number)),
                            poses.T_world_object[k, :3, 3], _TRUE)

    def estimate(self, stamps_s: Array, T: Array, objects: Array) -> None:
        """Estimated paths of the camera (K, 4, 4), and of objects by rows as in objects.txt."""
        self._path("world/estimate/camera_path", T[:, :3, 3], _ESTIMATED)
        for track in np.unique(objects[:, 1]):
            self._path(_object("estimate", f"track {int(track)}"),
                       objects[objects[:, 1] == track, 2:5], _ESTIMATED)
        for k, stamp in enumerate(stamps_s):
            self._stream.set_time("stamp", duration=float(stamp))
            self._log("world/estimate/camera", self._transform(T[k]))
            for row in objects[np.abs(objects[:, 0] - stamp) < 1e-6]:
                self._place(_object("estimate", f"track {int(row[1])}"), row[2:5], _ESTIMATED)

    def map(self, points: Array, lines: Array) -> None:
        """The map's points (P, 3) and lines (L, 2, 3)."""
        if len(points):
            self._log("world/map/points", self._rr.Points3D(points, radii=[_MAP_POINT_PX]),
                      static=True)
        if len(lines):
            self._log("world/map/lines", self._rr.LineStrips3D(lines, colors=[_LINES]),
                      static=True)

    def _log(self, path: str, what: Any, static: bool = False) -> None:
        self._stream.log(path, what, static=static)

    def _transform(self, T: Array) -> Any:
        return self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])

    def _path(self, path: str, points: Array, colour: tuple[int, int, int]) -> None:
        self._log(f"{path}/way", self._rr.LineStrips3D([points], colors=[colour]), static=True)

    def _place(self, path: str, point: Array, colour: tuple[int, int, int]) -> None:
        self._log(path, self._rr.Points3D([point], colors=[colour], radii=[_OBJECT_PX]))


def _object(whose: str, name: str) -> str:
    return f"world/{whose}/objects/{name.replace(' ', '_')}"
