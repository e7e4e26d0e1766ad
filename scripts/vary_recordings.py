"""Variants of the development recordings: played backwards, mirrored, and every second frame.

    python scripts/vary_recordings.py --data ../shared/data --out build/variants
    python scripts/measure_real.py --data build/variants/backwards

What was chosen on a recording must hold on its variants too: they show the same places, yet other
flows, other depth errors in other places of the image, and larger steps. Written are the four
folders that measure_real.py reads, below --out, once for each variant.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import yaml

from slam.geometry import se3
from slam.geometry.arrays import Array

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
ORDERS: dict[str, Callable[[int], Array]] = {
    "backwards": lambda n: np.arange(n)[::-1], "mirrored": np.arange,
    "every_second": lambda n: np.arange(0, n, 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("build/variants"))
    chosen = parser.parse_args()
    for variant in ORDERS:
        for name, write in WRITERS.items():
            if (chosen.data / name).is_dir():
                out = chosen.out / variant / name
                shutil.rmtree(out, ignore_errors=True)
                out.mkdir(parents=True)
                write(chosen.data / name, out, variant)
                print(out)


def kitti_odometry(source: Path, out: Path, variant: str) -> None:
    poses = np.tile(np.eye(4), (len(list((source / "image_0").glob("*.png"))), 1, 1))
    poses[:, :3] = np.loadtxt(source / "poses.txt").reshape(-1, 3, 4)
    projections = [line.split() for line in (source / "calib.txt").read_text().splitlines()]
    pair = ("image_0", "image_1")
    if variant == "mirrored":     # the right camera becomes the left one
        baseline_m = -float(projections[1][4]) / float(projections[1][1])
        poses[:, :3, 3] += baseline_m * poses[:, :3, 0]
        poses, pair = MIRROR @ poses @ MIRROR, pair[::-1]
        for row in projections:
            row[3] = str(_width(source / "image_0") - 1 - float(row[3]))
    order = ORDERS[variant](len(poses))
    np.savetxt(out / "poses.txt", _from_first(poses[order])[:, :3].reshape(-1, 12))
    np.savetxt(out / "times.txt", _times(np.loadtxt(source / "times.txt"), order))
    (out / "calib.txt").write_text("".join(" ".join(row) + "\n" for row in projections))
    for folder, written in zip(pair, ("image_0", "image_1"), strict=True):
        _copy_frames(source / folder, out / written, order, variant)


def kitti_tracking(source: Path, out: Path, variant: str) -> None:
    poses = np.loadtxt(source / "pose_gt.txt")[:, 1:].reshape(-1, 4, 4)
    objects = np.loadtxt(source / "object_pose.txt")
    settings = (source / "settings.yaml").read_text()
    if variant == "mirrored":
        right = _width(source / "image_0") - 1
        poses = MIRROR @ poses @ MIRROR
        objects[:, [2, 4]] = right - objects[:, [4, 2]]
        objects[:, [6, 9]] *= -1.0
        settings = "".join(
            f"Camera.cx: {right - float(line.split()[1])}\n" if line.startswith("Camera.cx")
            else line for line in settings.splitlines(keepends=True))
    order = ORDERS[variant](len(poses))
    place = np.full(len(poses), -1)
    place[order] = np.arange(len(order))
    objects[:, 0] = place[objects[:, 0].astype(np.int64)]
    objects = objects[objects[:, 0] >= 0]
    objects = objects[np.lexsort((objects[:, 1], objects[:, 0]))]
    truth = _from_first(poses[order]).reshape(-1, 16)
    np.savetxt(out / "pose_gt.txt", np.c_[np.arange(len(order)), truth], fmt=["%d"] + ["%.9f"] * 16)
    np.savetxt(out / "object_pose.txt", objects, fmt=["%d"] * 2 + ["%.6e"] * 8)
    np.savetxt(out / "times.txt", _times(np.loadtxt(source / "times.txt"), order))
    (out / "settings.yaml").write_text(settings)
    for folder in ("image_0", "depth"):
        _copy_frames(source / folder, out / folder, order, variant)
    (out / "semantic").mkdir()
    for number, k in enumerate(order):
        labels = np.loadtxt(source / "semantic" / f"{k:06d}.txt", dtype=np.int64)
        np.savetxt(out / "semantic" / f"{number:06d}.txt",
                   labels[:, ::-1] if variant == "mirrored" else labels, fmt="%d")


def tum(source: Path, out: Path, variant: str) -> None:
    calibration = yaml.safe_load((source / "calibration.yaml").read_text())
    truth = np.loadtxt(source / "groundtruth.txt")
    lists = {kind: [line.split() for line in (source / f"{kind}.txt").read_text().splitlines()
                    if not line.startswith("#")] for kind in ("rgb", "depth")}
    both_ends_s = float(lists["rgb"][0][0]) + float(lists["rgb"][-1][0])
    if variant == "mirrored":
        calibration["cx"] = calibration["width"] - 1 - calibration["cx"]
        if "distortion" in calibration:
            calibration["distortion"][3] *= -1.0      # p2, across
        truth[:, [1, 5, 6]] *= -1.0
    if variant == "backwards":
        truth = truth[::-1]
        truth[:, 0] = both_ends_s - truth[:, 0]
    np.savetxt(out / "groundtruth.txt", truth, fmt="%.6f")
    (out / "calibration.yaml").write_text(yaml.safe_dump(calibration))
    for kind, rows in lists.items():
        (out / kind).mkdir()
        chosen = [rows[k] for k in ORDERS[variant](len(rows))]
        with (out / f"{kind}.txt").open("w") as written:
            for stamp, file in chosen:
                stamp_s = both_ends_s - float(stamp) if variant == "backwards" else float(stamp)
                written.write(f"{stamp_s:.6f} {file}\n")
                _copy_image(source / file, out / file, variant)


def _times(stamps_s: Array, order: Array) -> Array:
    return np.sort(np.abs(stamps_s[order] - stamps_s[order[0]]))


def _from_first(poses: Array) -> Array:
    return np.asarray(se3.inverse(poses[0]) @ poses)


def _width(folder: Path) -> int:
    return int(cv2.imread(str(folder / "000000.png"), cv2.IMREAD_UNCHANGED).shape[1])


def _copy_frames(source: Path, out: Path, order: Array, variant: str) -> None:
    out.mkdir()
    for number, k in enumerate(order):
        _copy_image(source / f"{k:06d}.png", out / f"{number:06d}.png", variant)


def _copy_image(source: Path, out: Path, variant: str) -> None:
    image = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)
    assert image is not None, source
    cv2.imwrite(str(out), image[:, ::-1] if variant == "mirrored" else image)


WRITERS = {"kitti_tracking_0003": kitti_tracking, "kitti_odometry_06": kitti_odometry,
           "tum_fr1_rpy": tum, "tum_fr3_structure_notexture_far": tum}


if __name__ == "__main__":
    main()
