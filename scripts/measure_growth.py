"""Memory and time of a long run in which nothing new is seen after the first pass.

    python scripts/measure_growth.py [--system dpl] [--frames 1000] [--pass-frames 60]

A short sequence of Office-v0 without people is given to a system forth and back, again and again,
so that the map has no reason to grow after the first pass. Printed for each pass: resident memory,
what the map holds, and the median processor time of a frame. Exit code 1 if memory at the end is
more than 5 % above that after the second pass.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import sys
import time
from dataclasses import replace

import psutil

import slam
from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.systems.dpl import DplSlam
from slam.types import Frame, Intrinsics, Status

FLAT = 0.05


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--system", default="dpl", choices=("dpl", "orb", "orb-lines"))
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--pass-frames", type=int, default=60)
    parser.add_argument("--size", default="320x240")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(words)
    frames, intrinsics = _drawn(chosen)
    system = slam.make(chosen.system, intrinsics)
    assert isinstance(system, DplSlam)
    print("| frames | MB | map points: living, rows | lines: living, rows | keyframes: living, all "
          "| median ms of CPU | lost |\n|---|---|---|---|---|---|---|")
    megabytes: list[float] = []
    spent: list[float] = []
    lost = 0
    for number in range(chosen.frames):
        before = time.process_time()
        estimate = system.process(_repeated(frames, number))
        spent.append(1e3 * (time.process_time() - before))
        lost += estimate.status is Status.LOST
        if (number + 1) % len(frames) == 0:
            gc.collect()
            megabytes.append(psutil.Process().memory_info().rss / 1e6)
            print(_row(number + 1, megabytes[-1], system, statistics.median(spent), lost),
                  flush=True)
            spent.clear()
    growth = megabytes[-1] / megabytes[min(1, len(megabytes) - 1)]
    print(f"\nfrom the second pass to the last: {growth:.3f} times")
    return int(growth > 1.0 + FLAT)


def _drawn(chosen: argparse.Namespace) -> tuple[list[Frame], Intrinsics]:
    width, height = (int(n) for n in chosen.size.split("x"))
    world = make_world("Office-v0", chosen.seed, {"people": "none", "camera_motion": "halfsphere"},
                       (width, height))
    renderer = make_renderer("mujoco", world)
    feed = Feed(SimulatedSequence(world, renderer, chosen.pass_frames), InputChoice(
        flow="dis", masks="none", boxes="none", sensor="kinect"), chosen.seed)
    frames = [feed.frame(k) for k in range(chosen.pass_frames)]
    renderer.close()
    return frames, feed.intrinsics


def _repeated(frames: list[Frame], number: int) -> Frame:
    """Frame `number` of a run that goes forth and back over these; time goes on."""
    turn, at = divmod(number, len(frames))
    dt_s = frames[1].stamp_s - frames[0].stamp_s
    return replace(frames[at if turn % 2 == 0 else len(frames) - 1 - at], index=number,
                   stamp_s=frames[0].stamp_s + number * dt_s)


def _row(count: int, megabytes: float, system: DplSlam, ms: float, lost: int) -> str:
    points, lines, keyframes = system.map.points, system.map.lines, system.map.keyframes
    return (f"| {count} | {megabytes:.1f} | {points.alive.sum()}, {points.count} | "
            f"{lines.alive.sum()}, {lines.count} | {sum(k.alive for k in keyframes)}, "
            f"{len(keyframes)} | {ms:.1f} | {lost} |")


if __name__ == "__main__":
    sys.exit(main())
