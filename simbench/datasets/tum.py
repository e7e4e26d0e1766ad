"""TUM RGB-D folders: rgb.txt, depth.txt, groundtruth.txt and images named by time stamps."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from simbench.datasets.calibration import Calibration, missing_calibration, read_calibration
from simbench.datasets.fingerprint import folder_fingerprint
from simbench.datasets.images import read_colour, read_depth
from simbench.datasets.recorded_truth import RecordedTruth
from simbench.datasets.rows import check_increasing, numbers_of, read_rows
from simbench.errors import BadFile
from simbench.sequence import IteratesFrames
from simbench.trajectory_files import read_tum_trajectory
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics

_LONGEST_NAME = 1000
ASSOCIATION_S = 0.02      # as TUM's associate.py
TRUTH_GAP_S = 0.05        # a true pose is interpolated over no longer a gap than this on each side

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TumFolder(IteratesFrames):
    """A TUM RGB-D recording, undistorted to a pinhole camera of the same K."""

    folder: Path
    calibration: Calibration
    stamps_s: Array
    rgb_paths: tuple[Path, ...]
    depth_paths: tuple[Path, ...]
    truth: RecordedTruth | None
    undistortion: tuple[Array, Array] | None
    holds: frozenset[str] = frozenset({"depth"})

    @classmethod
    def open(cls, folder: Path, calibration: Path | None) -> TumFolder:
        """Read the lists. Raises BadFile on a broken row or without a calibration."""
        path = calibration or folder / "calibration.yaml"
        if calibration is None and not path.exists():
            raise missing_calibration(folder, "calibration.yaml")
        camera = read_calibration(path)
        stamps_s, rgb_paths, depth_paths = associated_images(folder)
        return cls(folder, camera, stamps_s, rgb_paths, depth_paths,
                   truth_of_folder(folder, stamps_s), camera.undistortion_maps())

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.resolve().name

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera of the undistorted images."""
        return self.calibration.intrinsics

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        """Colour and depth of frame k. Raises BadFrame when an image cannot be read."""
        camera = self.calibration
        rgb = read_colour(self.rgb_paths[k], camera.width, camera.height)
        depth_m = read_depth(self.depth_paths[k], camera.width, camera.height, camera.depth_scale)
        if self.undistortion is not None:
            rgb = cv2.remap(rgb, *self.undistortion, cv2.INTER_LINEAR)
            # Depths on either side of an edge must not be mixed: the nearest pixel's is taken.
            depth_m = cv2.remap(depth_m, *self.undistortion, cv2.INTER_NEAREST)
        return Frame(k, float(self.stamps_s[k]), rgb, depth_m, self.intrinsics)

    def fingerprint(self) -> str:
        """SHA-256 of lists, truth, calibration, image names and sizes."""
        return folder_fingerprint(self.folder, self.calibration)


def read_image_list(path: Path) -> tuple[Array, tuple[Path, ...]]:
    """Stamps (N,) in seconds and image paths of an rgb.txt or depth.txt. Raises BadFile."""
    stamps, paths = [], []
    for line, words in read_rows(path):
        if len(words) < 2:
            raise BadFile(f"{path}:{line}: {len(words)} columns, wanted 2 (t file); "
                          "mend or remove this row")
        stamps.append(numbers_of(path, line, words, 1, "t file")[0])
        name = PurePosixPath(words[1])
        if (name.is_absolute() or ".." in name.parts or "\0" in words[1]
                or len(words[1]) > _LONGEST_NAME):
            raise BadFile(f"{path}:{line}: {words[1]:.80} leads out of the folder; mend or remove "
                          "this row")
        paths.append(path.parent / name)
    return check_increasing(path, np.array(stamps)), tuple(paths)


def associated_images(folder: Path) -> tuple[Array, tuple[Path, ...], tuple[Path, ...]]:
    """Colour stamps (K,), colour and depth paths of the pairs that are nearest to each other.

    A colour image without a depth image within 0.02 s is left out, with a line in the log.
    """
    rgb_s, rgb_paths = read_image_list(folder / "rgb.txt")
    depth_s, depth_paths = read_image_list(folder / "depth.txt")
    rgb, depth = associate(rgb_s, depth_s, ASSOCIATION_S)
    if len(rgb) == 0:
        raise BadFile(f"{folder}: no colour image has a depth image within {ASSOCIATION_S} s; "
                      "check the stamps in rgb.txt and depth.txt")
    if len(rgb) < len(rgb_s):
        _log.warning("%s: %d of %d colour images have no depth image within %g s and are left out",
                     folder, len(rgb_s) - len(rgb), len(rgb_s), ASSOCIATION_S)
    return (rgb_s[rgb], tuple(rgb_paths[i] for i in rgb), tuple(depth_paths[i] for i in depth))


def associate(a_s: Array, b_s: Array, limit_s: float) -> tuple[Array, Array]:
    """Indices into two increasing stamp lists of the pairs that are each other's nearest."""
    nearest_b, nearest_a = _nearest(a_s, b_s), _nearest(b_s, a_s)
    a = np.arange(len(a_s))
    mutual = (nearest_a[nearest_b] == a) & (np.abs(a_s - b_s[nearest_b]) <= limit_s)
    return a[mutual], nearest_b[mutual]


def _nearest(a_s: Array, b_s: Array) -> Array:
    """For each of a, the index of the nearest of b (the earlier one of two equally near)."""
    after = np.clip(np.searchsorted(b_s, a_s), 1, max(1, len(b_s) - 1))
    before = after - 1
    after = np.minimum(after, len(b_s) - 1)
    return np.where(np.abs(a_s - b_s[before]) <= np.abs(b_s[after] - a_s), before, after)


def interpolate_poses(stamps_s: Array, truth_s: Array, T: Array) -> tuple[Array, Array]:
    """Poses (K, 4, 4) at `stamps_s` between those at `truth_s`, and which of them are known (K,).

    Positions linearly, rotations on the great arc between the two bracketing poses; known where
    both lie within 0.05 s (or one coincides). Unknown ones are the identity.
    """
    out = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    if len(truth_s) == 0:
        return out, np.zeros(len(stamps_s), dtype=bool)
    i = np.clip(np.searchsorted(truth_s, stamps_s, side="right") - 1, 0, len(truth_s) - 1)
    j = np.minimum(i + 1, len(truth_s) - 1)
    to_i, to_j = stamps_s - truth_s[i], truth_s[j] - stamps_s
    known = (to_i == 0) | ((to_i >= 0) & (to_j >= 0) & (np.maximum(to_i, to_j) <= TRUTH_GAP_S))
    share = (to_i / np.where(j > i, truth_s[j] - truth_s[i], 1.0))[:, None]
    R_i, R_j = T[i, :3, :3], T[j, :3, :3]
    turn = se3.log_so3(np.swapaxes(R_i, 1, 2) @ R_j)
    between = se3.from_rotation_translation(R_i @ se3.exp_so3(share * turn),
                                            (1 - share) * T[i, :3, 3] + share * T[j, :3, 3])
    return np.where(known[:, None, None], between, out), known


def truth_of_folder(folder: Path, stamps_s: Array) -> RecordedTruth | None:
    """The camera's truth at `stamps_s` from groundtruth.txt; None without one. Raises BadFile."""
    path = folder / "groundtruth.txt"
    if not path.exists():
        return None
    truth_s, poses = read_tum_trajectory(path)
    T, known = interpolate_poses(stamps_s, truth_s, poses)
    trajectories = Trajectories(stamps_s, T, known, {})
    return RecordedTruth(folder.name, lambda: trajectories, lambda k: None)
