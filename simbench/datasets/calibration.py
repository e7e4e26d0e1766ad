"""calibration.yaml: the camera of a folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simbench.errors import BadFile
from simbench.untrusted import MOST_SIDE_PX, read_yaml
from slam.geometry.arrays import Array
from slam.types import Intrinsics

KEYS = ("width, height, fx, fy, cx, cy, distortion (k1 k2 p1 p2 k3), depth_scale (PNG units per "
        "metre), baseline_m (stereo only)")
_REQUIRED = ("width", "height", "fx", "fy", "cx", "cy")
_MOST = {"width": (1, MOST_SIDE_PX), "height": (1, MOST_SIDE_PX), "fx": (1e-3, 1e6),
         "fy": (1e-3, 1e6), "depth_scale": (1e-3, 1e7), "baseline_m": (1e-6, 1e3)}
_FAR = 1e6
_KNOWN = {*_REQUIRED, "distortion", "depth_scale", "baseline_m"}


@dataclass(frozen=True, slots=True)
class Calibration:
    """A pinhole camera with OpenCV's distortion k1 k2 p1 p2 k3, and the scale of depth images."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    depth_scale: float = 5000.0        # PNG units per metre; 5000 as in TUM RGB-D
    baseline_m: float | None = None

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole camera of the undistorted images: same K, same size."""
        return Intrinsics(self.fx, self.fy, self.cx, self.cy, self.width, self.height,
                          self.baseline_m)

    def undistortion_maps(self) -> tuple[Array, Array] | None:
        """For `cv2.remap`: where each undistorted pixel lies in the image; None if undistorted."""
        if not any(self.distortion):
            return None
        K = self.intrinsics.matrix
        u, v = cv2.initUndistortRectifyMap(K, np.array(self.distortion), np.eye(3), K,
                                           (self.width, self.height), cv2.CV_32FC1)
        return u, v


def missing_calibration(folder: Path, wanted: str) -> BadFile:
    """The error for a folder that says nothing of its camera."""
    return BadFile(f"{folder}: no {wanted}; give --calibration FILE, a YAML file with the keys "
                   f"{KEYS}")


def read_calibration(path: Path) -> Calibration:
    """Read a calibration.yaml. Raises BadFile when a key is missing, unknown or not a number."""
    values = read_yaml(path, f"wanted the keys {KEYS}")
    if not isinstance(values, Mapping):
        raise BadFile(f"{path}: empty or not a mapping; wanted the keys {KEYS}")
    return _calibration_of(path, values)


def _calibration_of(path: Path, values: Mapping[str, Any]) -> Calibration:
    missing = [key for key in _REQUIRED if key not in values]
    if missing:
        raise BadFile(f"{path}: key {missing[0]!r} is missing; wanted {KEYS}")
    unknown = sorted(str(key) for key in values if key not in _KNOWN)
    if unknown:
        raise BadFile(f"{path}: unknown key {unknown[0]!r}; wanted {KEYS}")
    baseline = values.get("baseline_m")
    calibration = Calibration(
        width=int(_number(path, "width", values["width"])),
        height=int(_number(path, "height", values["height"])),
        fx=_number(path, "fx", values["fx"]), fy=_number(path, "fy", values["fy"]),
        cx=_number(path, "cx", values["cx"]), cy=_number(path, "cy", values["cy"]),
        distortion=_distortion(path, values.get("distortion")),
        depth_scale=_number(path, "depth_scale", values.get("depth_scale", 5000.0)),
        baseline_m=None if baseline is None else _number(path, "baseline_m", baseline))
    return checked_calibration(path, calibration)


def checked_calibration(path: Path, calibration: Calibration) -> Calibration:
    """The calibration itself. Raises BadFile where a number is out of all range."""
    for key, most in _MOST.items():
        value = getattr(calibration, key)
        if value is not None and value <= 0:
            raise BadFile(f"{path}: {key} is {value}; it must be above 0")
        if value is not None and not most[0] <= value <= most[1]:
            raise BadFile(f"{path}: {key} is {value:g}; wanted {most[0]:g} to {most[1]:g}")
    if max(abs(x) for x in (calibration.cx, calibration.cy, *calibration.distortion)) > _FAR:
        raise BadFile(f"{path}: cx, cy or the distortion is beyond {_FAR:g}; mend it")
    return calibration


def _distortion(path: Path, value: Any) -> tuple[float, ...]:
    if value is None:
        return (0.0,) * 5
    if not isinstance(value, list) or len(value) > 5:
        raise BadFile(f"{path}: distortion is {value!r:.60}; wanted a list [k1, k2, p1, p2, k3]")
    numbers = [_number(path, "distortion", x) for x in value]
    return tuple(numbers + [0.0] * (5 - len(numbers)))


def _number(path: Path, key: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise BadFile(f"{path}: {key} is {value!r:.60}; wanted a number")
    return number
