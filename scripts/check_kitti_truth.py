"""What the truth and the depth of kitti_tracking_0003 are worth: checked by the images alone.

    python scripts/check_kitti_truth.py [--data ../shared/data/kitti_tracking_0003]

Between neighbouring frames, static corners (Lucas-Kanade there and back, outside all masks) are
fitted by a rigid motion whose step length is free and whose depths are bf / (disparity + offset),
with the offset free as well. Neither our tracker nor the truth takes part. Three things are told:

    direction   of the camera's travel, x/z, beside the truth's
    offset      of the disparities, px; its effect on the length of the estimated step
    bf          what makes the step as long as the truth's, beside the two that are published:
                387.57 of cameras 0 and 1 (the folder's settings), 384.38 of the colour cameras 2, 3
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from simbench.sequence import Sequence, open_sequence
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics

BF = 387.5744              # of the folder's settings.yaml: gives disparities back from depths
BF_COLOUR = 384.3815       # (44.85728 + 339.5242) of P2, P3 in KITTI's calibration of the day
_OUTLIER_PX = 0.3          # width of the robust kernel
_START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2, 0.0])
_SCALE = np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Fit:
    """The motion between two frames, as the images tell it."""

    slope: float       # x/z of the direction of travel
    step_m: float
    offset_px: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data/kitti_tracking_0003"))
    sequence = open_sequence(parser.parse_args().data)
    assert sequence.truth is not None
    T = sequence.truth.trajectories.T_world_camera
    t_true = (se3.inverse(T[:-1]) @ T[1:])[:, :3, 3]
    step = float(np.mean(np.linalg.norm(t_true, axis=1)))
    free, held = _fits(sequence, offset=True), _fits(sequence, offset=False)

    slope, slope_true = _center([f.slope for f in free]), _center(t_true[:, 0] / t_true[:, 2])
    apart = np.arctan(slope_true[0]) - np.arctan(slope[0])
    sideways = step * np.sin(apart)
    print(f"{len(free)} pairs of frames; medians ± their standard errors\n")
    print(f"direction of travel x/z: images {_text(slope)}, truth {_text(slope_true)}")
    print(f"  apart by {np.degrees(apart):.2f}°: {sideways:.4f} m a frame at {step:.3f} m a frame, "
          f"{10 * sideways:.3f} m over 10 frames")
    print(f"offset of the disparities: {_text(_center([f.offset_px for f in free]))} px")
    for name, fits in (("with this offset", free), ("without any", held)):
        steps = _center([f.step_m for f in fits])
        ratio = steps[0] / step
        print(f"  {name:17} the step is {_text(steps)} m, {100 * (ratio - 1):+.1f} % of the "
              f"truth's; bf {BF / ratio:.1f} would make them equal")
    print(f"  published: bf {BF:.2f} (cameras 0, 1), {BF_COLOUR:.2f} (colour cameras 2, 3)")


def _fits(sequence: Sequence, offset: bool) -> list[Fit]:
    previous, out = sequence.frame(0), []
    for k in range(1, len(sequence)):
        frame = sequence.frame(k)
        uv_a, uv_b, disparity = _static_matches(previous, frame)
        out.append(_fitted(uv_a, uv_b, disparity, sequence.intrinsics, offset))
        previous = frame
    return out


def _static_matches(a: Frame, b: Frame) -> tuple[Array, Array, Array]:
    """Corners (N, 2) outside all masks, where they went, and their disparities (N,) in px."""
    gray_a, gray_b = (cv2.cvtColor(np.ascontiguousarray(f.rgb), cv2.COLOR_RGB2GRAY)
                      for f in (a, b))
    free = np.full(gray_a.shape, 255, np.uint8)
    if a.instance_id is not None:
        free[cv2.dilate((a.instance_id > 0).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0] = 0
    corners = cv2.goodFeaturesToTrack(gray_a, 2000, 0.005, 6, mask=free)
    settings = {"winSize": (17, 17), "maxLevel": 4}
    there, seen, _ = cv2.calcOpticalFlowPyrLK(gray_a, gray_b, corners, None, **settings)
    back, found, _ = cv2.calcOpticalFlowPyrLK(gray_b, gray_a, there, None, **settings)
    uv_a, uv_b, back = (x.reshape(-1, 2).astype(np.float64) for x in (corners, there, back))
    disparity, even = _disparity_at(a.depth_m, uv_a)
    good = (seen.ravel() == 1) & (found.ravel() == 1) & even & \
        (np.linalg.norm(back - uv_a, axis=1) < 0.2)
    return uv_a[good], uv_b[good], disparity[good]


def _disparity_at(depth_m: Array, uv: Array) -> tuple[Array, Array]:
    """Median disparity (N,) around pixels, and whether all around is one surface (N,)."""
    known = depth_m > 0
    image = np.divide(BF, depth_m, out=np.zeros_like(depth_m), where=known).astype(np.float32)
    window = np.ones((7, 7), np.uint8)
    column, row = np.rint(uv).astype(np.intp).T
    low, high = cv2.erode(image, window)[row, column], cv2.dilate(image, window)[row, column]
    middle = cv2.medianBlur(image, 5)[row, column].astype(np.float64)
    return middle, (low > 3.0) & (high - low < 0.15 * middle + 0.5)


def _fitted(uv_a: Array, uv_b: Array, disparity: Array, camera: Intrinsics, offset: bool) -> Fit:
    """The motion (rotation, slopes of its direction, step) and offset that explain the matches."""
    ray = np.stack([(uv_a[:, 0] - camera.cx) / camera.fx, (uv_a[:, 1] - camera.cy) / camera.fy,
                    np.ones(len(uv_a))], axis=-1)

    def residual(x: Array) -> Array:
        direction = np.array([x[3], x[4], 1.0])
        t = x[5] * direction / np.linalg.norm(direction)
        rho = (disparity + (x[6] if offset else 0.0)) / BF
        p = (ray - rho[:, None] * t) @ se3.exp_so3(x[:3])
        return np.concatenate([camera.fx * p[:, 0] / p[:, 2] + camera.cx - uv_b[:, 0],
                               camera.fy * p[:, 1] / p[:, 2] + camera.cy - uv_b[:, 1]])

    x = least_squares(residual, _START, loss="cauchy", f_scale=_OUTLIER_PX, x_scale=_SCALE).x
    return Fit(float(x[3]), float(x[5]), float(x[6]))


def _center(values: Array | list[float]) -> tuple[float, float]:
    """Median and its standard error, for a spread that is about normal."""
    spread = 1.4826 * np.median(np.abs(np.asarray(values) - np.median(values)))
    return float(np.median(values)), float(1.2533 * spread / np.sqrt(len(values)))


def _text(center: tuple[float, float]) -> str:
    return f"{center[0]:.4f} ± {center[1]:.4f}"


if __name__ == "__main__":
    main()
