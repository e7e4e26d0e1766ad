"""Our own sequences: a TUM RGB-D folder with masks, and exact truth in truth.zarr."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simbench.datasets.calibration import Calibration, missing_calibration, read_calibration
from simbench.datasets.images import read_colour, read_depth, read_uint16
from simbench.datasets.manifest import Manifest, read_manifest
from simbench.datasets.simbench_truth import StoredTruth
from simbench.errors import BadFile
from simbench.sequence import IteratesFrames
from simbench.storage import MANIFEST, image_path
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics


@dataclass(frozen=True)
class SimbenchFolder(IteratesFrames):
    """A generated sequence: as its sensor recorded it, masks bearing the true, constant ids."""

    folder: Path
    made: Manifest
    calibration: Calibration
    truth: StoredTruth

    @classmethod
    def open(cls, folder: Path, calibration: Path | None) -> SimbenchFolder:
        """Read manifest, calibration and poses. Raises BadFile."""
        made = read_manifest(folder)
        if calibration is None and not (folder / "calibration.yaml").exists():
            raise missing_calibration(folder, "calibration.yaml")
        camera = read_calibration(calibration or folder / "calibration.yaml")
        if any(camera.distortion):
            raise BadFile(f"{calibration}: generated images have no distortion; "
                          "take it out of the calibration")
        if (camera.width, camera.height) != made.size:
            raise BadFile(f"{folder / MANIFEST}: images of {made.size[0]}×{made.size[1]} pixels, "
                          f"the calibration says {camera.width}×{camera.height}; mend it")
        return cls(folder, made, camera, StoredTruth(folder, made, camera.intrinsics))

    @property
    def manifest(self) -> Mapping[str, Any]:
        """All that sequence.json says."""
        return self.made.said

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.made.scene.rpartition(":")[2]

    @property
    def stamps_s(self) -> Array:
        """(K,) seconds."""
        return self.truth.stamps_s

    @property
    def intrinsics(self) -> Intrinsics:
        """The camera; with a baseline where right images are there."""
        return self.calibration.intrinsics

    @property
    def holds(self) -> frozenset[str]:
        """Depth and masks, and stereo where it was asked for."""
        return frozenset({"depth", "masks"} | ({"stereo"} if self.made.stereo else set()))

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        """Frame k as the sensor gave it. Raises BadFrame when an image cannot be read."""
        stamp_s = float(self.stamps_s[k])
        camera = self.calibration
        size = camera.width, camera.height
        right = (read_colour(image_path(self.folder, "right", k), *size)
                 if self.made.stereo else None)
        return Frame(
            k, stamp_s, read_colour(image_path(self.folder, "rgb", k), *size),
            read_depth(image_path(self.folder, "depth", k), *size, camera.depth_scale),
            self.intrinsics,
            read_uint16(image_path(self.folder, "instance", k), *size).astype(np.int32),
            right=right)

    def fingerprint(self) -> str:
        """SHA-256 of the manifest, which holds that of every file."""
        return hashlib.sha256((self.folder / MANIFEST).read_bytes()).hexdigest()
