"""KITTI odometry folders: rectified stereo pairs, calib.txt, times.txt, poses.txt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simbench.datasets.calibration import missing_calibration, read_calibration
from simbench.datasets.fingerprint import folder_fingerprint
from simbench.datasets.image_header import image_size
from simbench.datasets.images import read_colour
from simbench.datasets.recorded_truth import RecordedTruth
from simbench.datasets.rows import check_increasing, numbers_of, read_numbers, read_rows
from simbench.errors import BadFile
from simbench.sequence import IteratesFrames
from simbench.trajectory_files import read_kitti_poses
from simbench.types import Trajectories
from simbench.untrusted import MOST_SIDE_PX, read_bytes
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics

_MOST_IMAGE_BYTES = 500_000_000
_MOST_BASELINE_M = 1000.0
_NO_STEREO: frozenset[str] = frozenset()


@dataclass(frozen=True)
class KittiOdometryFolder(IteratesFrames):
    """A KITTI odometry recording; depth is not in it, the right image is."""

    folder: Path
    intrinsics: Intrinsics
    stamps_s: Array
    left: str                 # "image_0" or "image_2"
    right: str | None         # "image_1" or "image_3"
    truth: RecordedTruth | None

    @classmethod
    def open(cls, folder: Path, calibration: Path | None) -> KittiOdometryFolder:
        """Read the lists. Raises BadFile on a broken row or without a calibration."""
        left, right, first = (("image_0", "image_1", 0) if (folder / "image_0").is_dir()
                              else ("image_2", "image_3", 2))
        stamps_s = check_increasing(folder / "times.txt",
                                    read_numbers(folder / "times.txt", 1, "t")[:, 0])
        projections = {} if calibration is not None else _read_projections(folder)
        has_right = (folder / right).is_dir()
        if calibration is not None:
            camera = read_calibration(calibration)
            if any(camera.distortion):
                raise BadFile(f"{calibration}: KITTI odometry images are rectified; "
                              "take distortion out of the calibration")
            intrinsics = camera.intrinsics
        else:
            intrinsics = _intrinsics(folder, projections, left, first, has_right)
        has_right = has_right and intrinsics.baseline_m is not None
        offset_m = _offset_from_camera_0(projections.get(f"P{first}"))
        return cls(folder, intrinsics, stamps_s, left, right if has_right else None,
                   _truth(folder, stamps_s, offset_m))

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.resolve().name

    @property
    def holds(self) -> frozenset[str]:
        """Stereo, where the right images are there."""
        return frozenset({"stereo"}) if self.right else _NO_STEREO

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        """The stereo pair of frame k, its depth all 0. Raises BadFrame."""
        stamp_s = float(self.stamps_s[k])
        camera = self.intrinsics
        size = camera.width, camera.height
        rgb = read_colour(self.folder / self.left / f"{k:06d}.png", *size)
        right = (read_colour(self.folder / self.right / f"{k:06d}.png", *size) if self.right
                 else None)
        return Frame(k, stamp_s, rgb, np.zeros(rgb.shape[:2], np.float32), camera, right=right)

    def fingerprint(self) -> str:
        """SHA-256 of times, truth, calibration, image names and sizes."""
        return folder_fingerprint(self.folder, self.intrinsics)


def _read_projections(folder: Path) -> dict[str, Array]:
    """The (3, 4) projections P0 … P3 of calib.txt. Raises BadFile."""
    path = folder / "calib.txt"
    if not path.exists():
        raise missing_calibration(folder, "calib.txt")
    return {words[0].rstrip(":"): np.array(numbers_of(
                path, line, words[1:], 12, "P0: and 12 numbers of a 3×4 projection")).reshape(3, 4)
            for line, words in read_rows(path) if words[0].startswith("P")}


def _intrinsics(folder: Path, projections: dict[str, Array], left: str, first: int,
                has_right: bool) -> Intrinsics:
    """The left camera; its size is that of the first image that can be read. Raises BadFile."""
    path = folder / "calib.txt"
    wanted = [f"P{first}"] + ([f"P{first + 1}"] if has_right else [])
    for key in wanted:
        if key not in projections:
            raise BadFile(f"{path}: no row {key}; add it or give --calibration FILE")
    P = projections[wanted[0]]
    if not (1e-3 < P[0, 0] < 1e6 and 1e-3 < P[1, 1] < 1e6 and np.abs(P).max() < 1e9
            and np.array_equal(P[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])):
        raise BadFile(f"{path}: {wanted[0]} is not fx 0 cx · 0 fy cy · 0 0 1 · with focal lengths "
                      "above 0 px; mend the row")
    baseline_m = None
    if has_right:
        baseline_m = float((P[0, 3] - projections[wanted[1]][0, 3]) / P[0, 0])
        if not 0 < baseline_m < _MOST_BASELINE_M:
            raise BadFile(f"{path}: the baseline of {wanted[0]} and {wanted[1]} is "
                          f"{baseline_m:.3f} m; it must be above 0")
    for image_path in sorted((folder / left).glob("*.png")):
        size = _size_of(image_path)
        if size is not None:
            return Intrinsics(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]),
                              *size, baseline_m)
    raise BadFile(f"{folder / left}: no image that can be read; restore the images")


def _size_of(path: Path) -> tuple[int, int] | None:
    """(width, height) by an image's header; None where it cannot be read or is too large."""
    try:
        size = image_size(read_bytes(path, _MOST_IMAGE_BYTES))
    except BadFile:
        return None
    return size if size and min(size) >= 1 and max(size) <= MOST_SIDE_PX else None


def _offset_from_camera_0(P: Array | None) -> Array:
    """(3,) where camera 0 lies in this camera's frame, in metres: K⁻¹ of P's last column."""
    return np.zeros(3) if P is None else np.linalg.solve(P[:, :3], P[:, 3])


def _truth(folder: Path, stamps_s: Array, offset_m: Array) -> RecordedTruth | None:
    """poses.txt are camera 0's in a world that is camera 0 at the first frame."""
    path = folder / "poses.txt"
    if not path.exists():
        return None
    poses = read_kitti_poses(path)
    if len(poses) != len(stamps_s):
        raise BadFile(f"{path}: {len(poses)} poses for the {len(stamps_s)} frames of times.txt; "
                      "give one row for each frame")
    T_0_camera = np.eye(4)
    T_0_camera[:3, 3] = -offset_m
    trajectories = Trajectories(stamps_s, poses @ T_0_camera, np.ones(len(poses), bool), {})
    return RecordedTruth(folder.name, lambda: trajectories, lambda k: None)
