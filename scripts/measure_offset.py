"""The offset of inverse depths that `dpl` learns, where one was put and where there is none.

    python scripts/measure_offset.py [--scenes Street-v0 Loop-v0] [--seeds 0 1 2] [--frames 40]
        [--pixels 0 0.5 -0.5] [--system dpl]

Depth comes as a Kinect's in rooms and with white noise of 0.002 z² m on Street-v0; Loop-v0 and
Street-v0/stereo bring pairs, which the system matches itself. `--pixels` are taken off every
disparity: of pairs by moving the right picture, of depth by taking as much off its inverse, a
pixel for 1/387 1/m, as on KITTI.

Prints a row for each run: what was put, what was learnt with its standard deviation, what was
applied (0: not believed), the frame in which it first was, and the RPE over 1 frame without and
with learning.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from simbench.inputs import Feed, InputChoice
from simbench.load_system import load_system
from simbench.metrics.trajectory import frame_pairs, rpe_errors
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.dpl.calibrate import DepthCalibration
from slam.geometry.arrays import Array
from slam.systems.dpl import DplSlam
from slam.types import Frame

_BF = 387.0              # px m, of KITTI
SCENES = {               # scene, size, sensor, pairs
    "Street-v0": ("Street-v0", (608, 184), "gaussian", False),
    "Street-v0/stereo": ("Street-v0", (608, 184), "ideal", True),
    "Loop-v0": ("Loop-v0", (608, 184), "ideal", True),
    "Office-v0": ("Office-v0", (320, 240), "kinect", False),
    "Corridor-v0": ("Corridor-v0", (320, 240), "kinect", False),
    "SwingingBoxes-v0": ("SwingingBoxes-v0", (320, 240), "kinect", False)}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--pixels", type=float, nargs="+", default=[0.0, 0.5])
    parser.add_argument("--system", default="dpl", choices=("dpl", "orb", "orb-lines"))
    given = parser.parse_args(arguments)
    print("| scene | seed | put 1/m | learnt 1/m | applied 1/m | first in frame | RPE m: without | "
          "with |\n|---|---|---|---|---|---|---|---|")
    for scene in given.scenes:
        for seed in given.seeds:
            _measure(scene, seed, given)


def _measure(scene: str, seed: int, given: argparse.Namespace) -> None:
    name, size, sensor, pairs = SCENES[scene]
    world = make_world(name, seed, {}, size)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, given.frames, stereo=pairs)
    feed = Feed(sequence, InputChoice(flow="dis", masks="none", boxes="truth", sensor=sensor,
                                      depth="stereo" if pairs else None), seed)
    camera = feed.intrinsics
    bf = camera.fx * (camera.baseline_m or _BF / camera.fx)
    runs = [(pixels, [load_system(given.system, camera, settings)[0] for settings in
                      ([f"depth.learn_depth_offset={on}"] for on in ("false", "true"))])
            for pixels in given.pixels]
    feed.leave_stereo_to(runs[0][1][0])
    poses: dict[tuple[float, int], list[Array]] = {}
    first: dict[float, int] = {}
    for k in range(given.frames):
        frame = feed.frame(k)
        for pixels, systems in runs:
            off = _with_offset(frame, pixels, bf)
            for i, system in enumerate(systems):
                poses.setdefault((pixels, i), []).append(system.process(off).T_world_camera)
            if _calibration(systems[1]).applied != 0.0:
                first.setdefault(pixels, k)
    renderer.close()
    true = sequence.truth.trajectories
    for pixels, systems in runs:
        learnt, applied = _calibration(systems[1]).learnt, _calibration(systems[1]).applied
        errors = [float(np.sqrt(np.mean(rpe_errors(
            np.array(poses[pixels, i]), true.T_world_camera[:given.frames],
            frame_pairs(given.frames, 1))[0] ** 2))) for i in (0, 1)]
        print(f"| {scene} | {seed} | {pixels / bf:.5f} | {learnt.mean:.5f} ± {learnt.sigma:.5f} | "
              f"{applied:.5f} | {first.get(pixels, '')} | {errors[0]:.4f} | {errors[1]:.4f} |",
              flush=True)


def _calibration(system: object) -> DepthCalibration:
    assert isinstance(system, DplSlam)
    return system.calibration


def _with_offset(frame: Frame, pixels: float, bf: float) -> Frame:
    """The frame with so many pixels taken off every disparity."""
    if pixels == 0.0:
        return frame
    if frame.right is not None:
        shift = np.array([[1.0, 0.0, pixels], [0.0, 1.0, 0.0]])
        size = frame.right.shape[1], frame.right.shape[0]
        right = cv2.warpAffine(frame.right, shift, size, flags=cv2.INTER_CUBIC,
                               borderMode=cv2.BORDER_REPLICATE)
        return replace(frame, right=right)
    depth = frame.depth_m
    rho = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0) - pixels / bf
    far = np.where(rho > 0.0, rho, 1.0)
    return replace(frame, depth_m=np.where((depth > 0) & (rho > 0.0), 1.0 / far, 0.0).astype(
        np.float32))


if __name__ == "__main__":
    main()
