"""The VDO-SLAM / SDPL-SLAM layout, metric (ChooseData 1) and KITTI (ChooseData 2)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simbench.datasets.calibration import (
    Calibration,
    checked_calibration,
    missing_calibration,
    read_calibration,
)
from simbench.datasets.fingerprint import folder_fingerprint
from simbench.datasets.flo import read_flo
from simbench.datasets.images import read_colour, read_depth, read_disparity_as_depth
from simbench.datasets.recorded_truth import RecordedTruth
from simbench.datasets.rows import check_increasing, read_numbers
from simbench.datasets.vdo_truth import read_trajectories
from simbench.errors import BadFile, BadFrame
from simbench.sequence import IteratesFrames
from simbench.untrusted import read_bytes, read_text
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, Intrinsics

_FAR = 1e9
METRIC, KITTI = 1, 2      # ChooseData of their settings files


@dataclass(frozen=True)
class VdoFolder(IteratesFrames):
    """A recording in the layout that dynamic SLAM programs read."""

    folder: Path
    calibration: Calibration
    kind: int                 # METRIC or KITTI
    bf_px_m: float            # baseline × fx; used by KITTI only
    stamps_s: Array
    truth: RecordedTruth | None
    holds: frozenset[str]

    @classmethod
    def open(cls, folder: Path, calibration: Path | None) -> VdoFolder:
        """Read settings and times. Raises BadFile on a broken row or without a calibration."""
        stamps_s = check_increasing(folder / "times.txt",
                                    read_numbers(folder / "times.txt", 1, "t")[:, 0])
        settings = _read_settings(folder / "settings.yaml")
        if settings is None and calibration is None:
            raise missing_calibration(folder, "settings.yaml")
        # Without settings the depth is metric, as calibration.yaml's depth_scale says.
        kind = METRIC if settings is None else int(settings.number("ChooseData"))
        if kind not in (METRIC, KITTI):
            raise BadFile(f"{folder / 'settings.yaml'}: ChooseData is {kind}; wanted 1 (metric) "
                          "or 2 (KITTI)")
        if calibration is not None:
            camera = read_calibration(calibration)
        else:
            assert settings is not None
            camera = _camera_of_settings(settings)
        if any(camera.distortion):
            raise BadFile(f"{settings.path if settings and not calibration else calibration}: "
                          "images of this layout are undistorted; set k1 k2 p1 p2 k3 to 0")
        bf_px_m = settings.number("Camera.bf") if settings and kind == KITTI else 0.0
        parts = {"depth": "depth", "masks": "semantic", "flow": "flow"}
        holds = frozenset(key for key, name in parts.items() if (folder / name).is_dir())
        return cls(folder, camera, kind, bf_px_m, stamps_s,
                   _truth(folder, kind, stamps_s, camera, "masks" in holds), holds)

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self.folder.resolve().name

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera; there is no right image in this layout."""
        c = self.calibration
        return Intrinsics(c.fx, c.fy, c.cx, c.cy, c.width, c.height)

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        """Frame k with what the folder holds of depth, masks and flow. Raises BadFrame."""
        stamp_s = float(self.stamps_s[k])
        size = self.calibration.width, self.calibration.height
        rgb = read_colour(self.folder / "image_0" / f"{k:06d}.png", *size)
        masks = (read_semantic(self.folder / "semantic" / f"{k:06d}.txt", *size)
                 if "masks" in self.holds else None)
        return Frame(k, stamp_s, rgb, self._depth(k), self.intrinsics, masks, flow=self._flow(k))

    def _depth(self, k: int) -> Array:
        camera = self.calibration
        if "depth" not in self.holds:
            return np.zeros((camera.height, camera.width), np.float32)
        path = self.folder / "depth" / f"{k:06d}.png"
        if self.kind == KITTI:
            return read_disparity_as_depth(path, camera.width, camera.height, camera.depth_scale,
                                           self.bf_px_m)
        return read_depth(path, camera.width, camera.height, camera.depth_scale)

    def _flow(self, k: int) -> FlowField | None:
        """File k−1 holds the flow from k−1 to k, which is what frame k is given."""
        if "flow" not in self.holds or k == 0:
            return None
        return read_flo(self.folder / "flow" / f"{k - 1:06d}.flo", self.calibration.width,
                        self.calibration.height)

    def fingerprint(self) -> str:
        """SHA-256 of settings, times, truth, and the other files' names and sizes."""
        return folder_fingerprint(self.folder, self.calibration)


def read_semantic(path: Path, width: int, height: int) -> Array:
    """(H, W) int32 labels of one frame; 0 = static. Raises BadFrame."""
    data = read_bytes(path, 16 * width * height + 4096, BadFrame, "mask file")
    try:
        labels = np.fromstring(data.decode("ascii"), dtype=np.int32, sep=" ")
    except ValueError:
        raise BadFrame(f"{path}: a label is not an integer; replace the file") from None
    if labels.size != width * height:
        raise BadFrame(f"{path}: {labels.size} labels, the calibration says {width}×{height} = "
                       f"{width * height}; copy the file again")
    return np.maximum(labels, 0).reshape(height, width)   # below 0: "unknown" in their programs


@dataclass(frozen=True)
class _Settings:
    """An OpenCV FileStorage of scalars, which YAML readers refuse for its `%YAML:1.0` head."""

    path: Path
    values: dict[str, str]

    def number(self, key: str, default: float | None = None) -> float:
        """The number under a key. Raises BadFile when it is missing or none."""
        if key not in self.values:
            if default is not None:
                return default
            raise BadFile(f"{self.path}: key {key} is missing; add it")
        try:
            number = float(self.values[key])
        except ValueError:
            number = math.nan
        if not abs(number) < _FAR:
            raise BadFile(f"{self.path}: {key} is {self.values[key]!r:.60}; wanted a number")
        return number


def _read_settings(path: Path) -> _Settings | None:
    """Scalars of settings.yaml; None where there is no such file."""
    if not path.exists():
        return None
    found = re.findall(r"^([\w.]+)[ \t]*:[ \t]*([^\s#]+)", read_text(path), flags=re.MULTILINE)
    return _Settings(path, dict(found))


def _camera_of_settings(settings: _Settings) -> Calibration:
    fx, fy = settings.number("Camera.fx"), settings.number("Camera.fy")
    width, height = settings.number("Camera.width"), settings.number("Camera.height")
    depth_scale = settings.number("DepthMapFactor")
    if min(fx, fy, width, height, depth_scale) <= 0:
        raise BadFile(f"{settings.path}: Camera.fx, fy, width, height and DepthMapFactor must be "
                      "above 0; mend them")
    distortion = tuple(settings.number(f"Camera.{k}", 0.0) for k in ("k1", "k2", "p1", "p2", "k3"))
    return checked_calibration(settings.path, Calibration(
        int(width), int(height), fx, fy, settings.number("Camera.cx"),
        settings.number("Camera.cy"), distortion, depth_scale))


def _truth(folder: Path, kind: int, stamps_s: Array, camera: Calibration,
           has_masks: bool) -> RecordedTruth | None:
    """Poses, and the masks themselves, whose labels are the true ids in this layout."""
    if not (folder / "pose_gt.txt").exists():
        return None

    def instances(k: int) -> Array | None:
        if not has_masks:
            return None
        return read_semantic(folder / "semantic" / f"{k:06d}.txt", camera.width, camera.height)

    return RecordedTruth(folder.name, lambda: read_trajectories(
        folder, stamps_s, object_rows_in_camera=kind == KITTI, instances=instances), instances)
