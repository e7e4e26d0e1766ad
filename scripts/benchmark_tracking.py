"""How long tracking takes: each stage, median and 95th percentile, wall clock and processor time.

    python scripts/benchmark_tracking.py [--system sdpl] [--seed 0] [--frames 120] [--warm-up 20]

SwingingBoxes-v0 at 640×480 with four moving objects, drawn before the clock starts: once with flow
and masks given (wanted: 25 ms a frame in the median), once with flow from the images (DIS, wanted:
40 ms). Systems that use no flow (dpl, orb) run once, with the true boxes (wanted: 20 ms). The first
frames, in which functions are compiled and caches fill, are left out.

A loaded machine is slower. So the load average is printed, and what a fixed piece of NumPy and
OpenCV work takes before and after: runs compare where this calibration is alike. The 10th
percentile is what the least disturbed frames took.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

import slam
from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.dpl.config import DplConfig
from slam.systems.registry import PRESETS
from slam.types import Frame, Intrinsics, Status

CASES = (   # name, flow, wanted median in ms
    ("flow and masks given", "noisy", 25.0),
    ("flow from the images", "dis", 40.0),
)
DPL_CASES = (("boxes given", "dis", 20.0),)


@dataclass(frozen=True, slots=True)
class Spent:
    """Milliseconds of each frame."""

    wall: list[float]
    processor: list[float]            # of all threads of the process
    stages: list[dict[str, float]]
    objects: list[int]                # motions estimated
    inliers: list[dict[str, int]]     # features that were fitted, by kind
    lost: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--system", default="sdpl", choices=sorted(PRESETS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--warm-up", type=int, default=20)
    parser.add_argument("--passes", type=int, default=3, help="fresh systems on the same frames")
    chosen = parser.parse_args()
    print(f"{os.cpu_count()} cores, load average {_load()}; calibration {_calibration_ms():.1f} ms")
    is_dpl = isinstance(PRESETS[chosen.system].config, DplConfig)
    for name, flow, wanted in DPL_CASES if is_dpl else CASES:
        frames, intrinsics = _drawn(flow, chosen.seed, chosen.frames)
        passes = [_track(chosen.system, frames, intrinsics, chosen.warm_up)
                  for _ in range(chosen.passes)]
        _print(f"{chosen.system}, {name}", passes, wanted)
    print(f"\nload average {_load()}; calibration {_calibration_ms():.1f} ms")


def _drawn(flow: str, seed: int, count: int) -> tuple[list[Frame], Intrinsics]:
    """All frames in memory, so that drawing does not disturb what is measured."""
    world = make_world("SwingingBoxes-v0", seed)
    renderer = make_renderer("mujoco", world)
    feed = Feed(SimulatedSequence(world, renderer, count), InputChoice(
        flow=flow, flow_sigma_px=0.3, depth="sensor", sensor="gaussian", masks="truth"), seed)
    frames = [feed.frame(k) for k in range(count)]
    renderer.close()
    return frames, feed.intrinsics


def _track(system: str, frames: Sequence[Frame], intrinsics: Intrinsics, warm_up: int) -> Spent:
    tracker = slam.make(system, intrinsics)
    spent = Spent([], [], [], [], [], 0)
    lost = 0
    for frame in frames:
        wall, processor = time.perf_counter(), time.process_time()
        estimate = tracker.process(frame)
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
        if frame.index < warm_up:
            continue
        spent.wall.append(1e3 * wall)
        spent.processor.append(1e3 * processor)
        spent.stages.append(dict(estimate.timings_ms))
        spent.objects.append(len(estimate.objects))
        spent.inliers.append(dict(estimate.inliers))
        lost += estimate.status is Status.LOST
    return Spent(spent.wall, spent.processor, spent.stages, spent.objects, spent.inliers, lost)


def _print(title: str, passes: Sequence[Spent], wanted: float) -> None:
    """A table over all passes, and each pass's median: they tell a machine that was disturbed."""
    objects = statistics.fmean(n for p in passes for n in p.objects)
    print(f"\n{title}: {sum(len(p.wall) for p in passes)} frames, {objects:.1f} object motions a "
          f"frame, {sum(p.lost for p in passes)} lost; features fitted, "
          f"median: {_fitted(passes)}\n")
    print("| stage | median ms | p95 ms | p10 ms |\n|---|---|---|---|")
    stages = [stage for p in passes for stage in p.stages]
    for name in dict.fromkeys(key for stage in stages for key in stage):
        _row(name, [stage.get(name, 0.0) for stage in stages])
    wall = [ms for p in passes for ms in p.wall]
    _row(f"**frame, wall clock** (wanted: median ≤ {wanted:g})", wall)
    _row("frame, processor time of all threads", [ms for p in passes for ms in p.processor])
    medians = ", ".join(f"{statistics.median(p.wall):.1f}" for p in passes)
    print(f"\nmedian of each pass: {medians} ms")


def _fitted(passes: Sequence[Spent]) -> str:
    every = [inliers for p in passes for inliers in p.inliers]
    kinds = dict.fromkeys(kind for inliers in every for kind in inliers)
    return ", ".join(f"{statistics.median(i.get(kind, 0) for i in every):.0f} {kind}"
                     for kind in kinds)


def _row(name: str, values: Sequence[float]) -> None:
    p10, median, p95 = np.percentile(values, [10, 50, 95])
    print(f"| {name} | {median:.1f} | {p95:.1f} | {p10:.1f} |")


def _load() -> str:
    return ", ".join(f"{x:.1f}" for x in os.getloadavg())


def _calibration_ms() -> float:
    """Median of a fixed piece of work, half NumPy on one thread and half OpenCV on all."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (480, 640), dtype=np.uint8)
    blocks, pixels = rng.standard_normal((20_000, 6, 6)), rng.standard_normal((480, 640))
    steps: tuple[Callable[[], object], ...] = (
        lambda: blocks @ blocks,
        lambda: np.sort(pixels, axis=1),
        lambda: cv2.GaussianBlur(image, (15, 15), 3.0),
        lambda: cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST).calc(
            image, np.roll(image, 2, axis=1), None))
    spent = []
    for _ in range(15):
        start = time.perf_counter()
        for step in steps:
            step()
        spent.append(1e3 * (time.perf_counter() - start))
    return statistics.median(spent)


if __name__ == "__main__":
    main()
