"""A sequence in the KITTI layouts: odometry, and tracking labels beside it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from simbench.export.kitti_labels import label_rows
from simbench.export.target import make_folder
from simbench.sequence import Sequence
from simbench.storage import write_bytes, write_png
from simbench.trajectory_files import kitti_lines
from slam.geometry import se3
from slam.types import Intrinsics

_LEFT, _RIGHT = "image_2", "image_3"     # KITTI's colour cameras
_log = logging.getLogger(__name__)


def export_kitti(sequence: Sequence, out: Path,
                 on_frame: Callable[[], None] = lambda: None) -> None:
    """Write image_2/, image_3/ (stereo), times.txt, calib.txt, poses.txt, label_02/0000.txt.

    All four cameras of calib.txt stand where the left one (0 and 2) or the right one (1 and 3)
    does. Poses are those of the left camera in its own first frame, as KITTI's are. Labels, as
    the tracking benchmark has them, are written where the truth knows the sizes of things: of
    simulated sequences. What is left out, the log names.

    Raises:
        UserError: the folder is not empty.
        BadFrame: a frame cannot be read.
    """
    make_folder(out)
    stereo = "stereo" in sequence.holds
    if not stereo:
        _log.warning("%s holds no right images: no %s/ is written; `simbench generate --stereo` "
                     "renders them", sequence.name, _RIGHT)
    for name in (_LEFT, *((_RIGHT,) if stereo else ())):
        (out / name).mkdir()
    rows: list[str] = []
    labelled = sequence.truth is not None and sequence.truth.has_images
    for k in range(len(sequence)):
        frame = sequence.frame(k)
        write_png(out / _LEFT / f"{k:06d}.png", frame.rgb)
        if stereo:
            assert frame.right is not None
            write_png(out / _RIGHT / f"{k:06d}.png", frame.right)
        if labelled:
            assert sequence.truth is not None
            rows += label_rows(sequence.truth, k)
        on_frame()
    times = "".join(f"{stamp:.6e}\n" for stamp in sequence.stamps_s - sequence.stamps_s[0])
    write_bytes(out / "times.txt", times.encode())
    write_bytes(out / "calib.txt", _projections(sequence.intrinsics, stereo).encode())
    _write_poses(sequence, out)
    if labelled:
        (out / "label_02").mkdir()
        write_bytes(out / "label_02" / "0000.txt", "".join(rows).encode())
    else:
        _log.warning("%s: the sizes of its things are not known: no label_02/ is written",
                     sequence.name)


def _projections(camera: Intrinsics, stereo: bool) -> str:
    """Rows P0 … P3; the right camera's last column holds −fx · baseline."""
    rows = []
    for number in range(4):
        P = np.zeros((3, 4))
        P[:, :3] = camera.matrix
        if stereo and number % 2:
            P[0, 3] = -camera.fx * (camera.baseline_m or 0.0)
        rows.append(f"P{number}: " + " ".join(f"{x:.12e}" for x in P.ravel()) + "\n")
    return "".join(rows)


def _write_poses(sequence: Sequence, out: Path) -> None:
    truth = None if sequence.truth is None else sequence.truth.trajectories
    if truth is None or not np.all(truth.camera_valid):
        _log.warning("%s: the camera's true pose is not known in every frame, which this layout "
                     "cannot say: no poses.txt is written", sequence.name)
        return
    T_first_camera = se3.inverse(truth.T_world_camera[0]) @ truth.T_world_camera
    write_bytes(out / "poses.txt", kitti_lines(T_first_camera).encode())
