"""What exact truth costs: generation in memory against bare MuJoCo renders of the same frames.

    python scripts/benchmark_generation.py [SCENE ...] [--frames 40]

First, for each scene, one process and one run: RGB (shadows, 4 samples a pixel), depth, ids, flow
to the next frame and all masks, against mujoco.Renderer's RGB, depth and segmentation. Then two
processes against one, with one rendering thread each.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable

import mujoco

from simbench.render import gl, make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world

_MODES = ("colour", "depth", "segmentation")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("scenes", nargs="*", default=["SwingingBoxes-v0", "Street-v0"])
    options.add_argument("--frames", type=int, default=40)
    options.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.worker:
        _work(given.scenes[0], given.frames)
        return
    print(gl.gl_renderer_name())
    for scene in given.scenes:
        _compare_with_bare(scene, given.frames)
        _compare_workers(scene, given.frames)


def _compare_with_bare(scene: str, frames: int) -> None:
    """Alternate frame by frame, so that both meet the same state of the machine."""
    world = make_world(scene)
    sequence = SimulatedSequence(world, make_renderer("mujoco", world), frames)
    gl.choose_platform()
    height, width = sequence.intrinsics.height, sequence.intrinsics.width
    model = world.model
    model.vis.quality.offsamples = 4
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    bare = mujoco.Renderer(model, height, width)
    seconds = dict.fromkeys((*_MODES, "picture", "depth and ids", "flow and masks"), 0.0)
    for k in range(frames):
        at_k = sequence.truth.world_at(k)
        for mode in _MODES:
            _set_mode(bare, mode)
            spent = _seconds(lambda at_k=at_k: (bare.update_scene(at_k.data, "camera"),
                                                bare.render()))
            seconds[mode] += spent if k else 0.0
        steps: dict[str, Callable[[], object]] = {
            "picture": lambda k=k: sequence.rgb(k),
            "depth and ids": lambda k=k: sequence.truth.frame(k),
            "flow and masks": lambda k=k: sequence.truth.flow(k - 1, k) if k else None}
        for name, step in steps.items():
            spent = _seconds(step)
            seconds[name] += spent if k else 0.0
    bare.close()
    shares = {name: 1e3 * value / (frames - 1) for name, value in seconds.items()}
    plain = sum(shares[mode] for mode in _MODES)
    exact = sum(shares.values()) - plain
    print(f"\n{scene} at {width}x{height}, ms a frame over {frames - 1} frames")
    for name, value in shares.items():
        print(f"  {'bare ' + name if name in _MODES else name:20} {value:8.1f}")
    print(f"  bare {plain:.1f}, exact {exact:.1f}: ratio {exact / plain:.2f} (wanted: at most 1.5)")


def _set_mode(renderer: mujoco.Renderer, mode: str) -> None:
    renderer.disable_depth_rendering()
    renderer.disable_segmentation_rendering()
    if mode == "depth":
        renderer.enable_depth_rendering()
    elif mode == "segmentation":
        renderer.enable_segmentation_rendering()


def _seconds(step: Callable[[], object]) -> float:
    start = time.perf_counter()
    step()
    return time.perf_counter() - start


def _compare_workers(scene: str, frames: int) -> None:
    one, two = _rate(scene, frames, 1), _rate(scene, frames, 2)
    print(f"  one worker {one:.1f} frames/s, two workers {two:.1f}: "
          f"{two / one:.2f} times as many (wanted: at least 1.7)")


def _rate(scene: str, frames: int, workers: int) -> float:
    """Frames a second of all workers while all of them work."""
    environment = {**os.environ, "LP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, scene, "--frames", str(frames), "--worker"]
    running = [subprocess.Popen(command, env=environment, text=True, stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE) for _ in range(workers)]
    for worker in running:   # each says when it is ready, and waits for the word to go
        assert worker.stdout is not None
        worker.stdout.readline()
    for worker in running:
        assert worker.stdin is not None
        worker.stdin.write("go\n")
        worker.stdin.flush()
    return sum(float(worker.communicate()[0]) for worker in running)


def _work(scene: str, frames: int) -> None:
    world = make_world(scene)
    sequence = SimulatedSequence(world, make_renderer("mujoco", world), frames)
    sequence.frame(0)
    print("ready", flush=True)
    sys.stdin.readline()
    seconds = _seconds(lambda: [sequence.frame(k) for k in range(1, frames)])
    print((frames - 1) / seconds)


if __name__ == "__main__":
    main()
