"""Small recordings written for tests, in each of the layouts that are read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 32, 24
CALIBRATION = (f"width: {WIDTH}\nheight: {HEIGHT}\nfx: 30.0\nfy: 31.0\ncx: 15.5\ncy: 11.5\n"
               "distortion: [0, 0, 0, 0, 0]\ndepth_scale: 5000.0\n")
SETTINGS = ("%YAML:1.0\nCamera.fx: 30.0\nCamera.fy: 31.0\nCamera.cx: 15.5\nCamera.cy: 11.5\n"
            f"Camera.k1: 0.0\nCamera.width: {WIDTH}\nCamera.height: {HEIGHT}\nCamera.bf: 12.0\n"
            "ChooseData: {kind}\nDepthMapFactor: {factor}\n")


def picture(seed: int, channels: int = 3):
    """Random colours; BGR as OpenCV writes them."""
    shape = (HEIGHT, WIDTH, channels) if channels > 1 else (HEIGHT, WIDTH)
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def raw_depth(seed: int):
    return np.random.default_rng(seed).integers(1, 60000, (HEIGHT, WIDTH)).astype(np.uint16)


def save(path: Path, image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def tum_folder(folder: Path, frames: int = 4, calibration: str | None = CALIBRATION) -> Path:
    """Colour at k/10 s, depth 4 ms later, truth every 20 ms moving 1 m/s along x and turning."""
    folder.mkdir(parents=True)
    for kind, offset in (("rgb", 0.0), ("depth", 0.004)):
        rows = ["# timestamp filename"]
        for k in range(frames):
            rows.append(f"{100 + k / 10 + offset:.6f} {kind}/{k}.png")
            save(folder / kind / f"{k}.png", picture(k) if kind == "rgb" else raw_depth(k))
        (folder / f"{kind}.txt").write_text("\n".join(rows) + "\n")
    t = np.arange(-5, frames * 5 + 5) * 0.02 + 0.007
    (folder / "groundtruth.txt").write_text("# t\n" + "".join(
        f"{100 + s:.6f} {s:.9f} 0 0 0 0 {np.sin(s / 2):.12f} {np.cos(s / 2):.12f}\n" for s in t))
    if calibration is not None:
        (folder / "calibration.yaml").write_text(calibration)
    return folder


def kitti_folder(folder: Path, frames: int = 3, colour: bool = False) -> Path:
    """Baseline 0.5 m; camera 2 stands 0.1 m left of camera 0."""
    left, right = ("image_2", "image_3") if colour else ("image_0", "image_1")
    for k in range(frames):
        for i, side in enumerate((left, right)):
            save(folder / side / f"{k:06d}.png", picture(10 * k + i, 3 if colour else 1))
    shifts = {"P0": 0.0, "P1": -15.0, "P2": 3.0, "P3": -12.0}
    (folder / "calib.txt").write_text("".join(
        f"{name}: 30 0 15.5 {shift} 0 30 11.5 0 0 0 1 0\n" for name, shift in shifts.items())
        + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    (folder / "times.txt").write_text("".join(f"{k / 10:e}\n" for k in range(frames)))
    (folder / "poses.txt").write_text("".join(
        f"1 0 0 0 0 1 0 0 0 0 1 {k * 1.5}\n" for k in range(frames)))
    return folder


def vdo_folder(folder: Path, kind: int, frames: int = 3) -> Path:
    """Object 7 in every frame, object 8 with rows always but a mask in the last frame only."""
    for k in range(frames):
        save(folder / "image_0" / f"{k:06d}.png", picture(k))
        save(folder / "depth" / f"{k:06d}.png", raw_depth(k))
        mask = np.zeros((HEIGHT, WIDTH), int)
        mask[2:8, 3:9] = 7
        if k == frames - 1:
            mask[10:14, 20:25] = 8
        (folder / "semantic").mkdir(exist_ok=True)
        (folder / "semantic" / f"{k:06d}.txt").write_text(
            "\n".join(" ".join(map(str, row)) for row in mask) + "\n")
    (folder / "times.txt").write_text("".join(f"{k / 10}\n" for k in range(frames)))
    pose = "1 0 0 0 0 1 0 0 0 0 1 {z} 0 0 0 1"
    (folder / "pose_gt.txt").write_text("".join(
        f"{k} {pose.format(z=k)}\n" for k in range(frames)))
    row = "{k} {i} 1 2 3 4 1.0 2.0 9.0 0.25\n" if kind == 2 else "{k} {i} 1.0 2.0 9.0 0 0 0.5 9\n"
    (folder / "object_pose.txt").write_text("".join(
        row.format(k=k, i=i) for k in range(frames) for i in (7, 8)))
    (folder / "settings.yaml").write_text(
        SETTINGS.format(kind=kind, factor=256.0 if kind == 2 else 5000.0))
    return folder
