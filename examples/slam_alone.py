"""The SLAM library by itself, on frames made of arrays: nothing of the benchmark is imported.

Reads a folder with `rgb/*.png` and `depth/*.png` (16 bits) and prints the path of the camera.
Replace `frames` by your camera's driver. Without flow the system computes it from the images;
without masks everything belongs to the background, and what moves against it is left out as
outliers.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import slam
from slam.types import Frame, Intrinsics

FPS = 30.0


def frames(folder: Path, intrinsics: Intrinsics, depth_per_m: float) -> Iterator[Frame]:
    pairs = zip(sorted((folder / "rgb").iterdir()), sorted((folder / "depth").iterdir()),
                strict=True)
    for k, (colour, depth) in enumerate(pairs):
        rgb = cv2.imread(str(colour))[..., ::-1]
        depth_m = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).astype(np.float32) / depth_per_m
        yield Frame(k, k / FPS, rgb, depth_m, intrinsics)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--focal-px", type=float, default=554.7,
                        help="of SwingingBoxes-v0 at 480 rows")
    parser.add_argument("--depth-per-m", type=float, default=5000.0)
    asked = parser.parse_args(arguments)

    height, width = cv2.imread(str(next((asked.folder / "rgb").iterdir()))).shape[:2]
    intrinsics = Intrinsics(asked.focal_px, asked.focal_px, (width - 1) / 2, (height - 1) / 2,
                            width, height)
    system = slam.make("sdpl", intrinsics)
    for frame in frames(asked.folder, intrinsics, asked.depth_per_m):
        estimate = system.process(frame)
        x, y, z = estimate.T_world_camera[:3, 3]
        print(f"frame {frame.index}: {estimate.status}, camera at {x:+.4f} {y:+.4f} {z:+.4f} m")
    print(f"{len(system.finish().stamps_s)} poses")


if __name__ == "__main__":
    main()
