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
from collections import Counter
from collections.abc import Callable

from simbench.render import gl

gl.choose_platform()   # mujoco.Renderer takes what stands when mujoco is first imported

import mujoco  # noqa: E402

from simbench.render import make_renderer  # noqa: E402
from simbench.simulate import SimulatedSequence  # noqa: E402
from simbench.world import make_world  # noqa: E402

_BLOCK = 5


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
    """Alternate every few frames, so that both meet the same state of the machine."""
    world = make_world(scene)
    sequence = SimulatedSequence(world, make_renderer("mujoco", world), frames)
    height, width = sequence.intrinsics.height, sequence.intrinsics.width
    world.model.vis.quality.offsamples = 4
    bare = mujoco.Renderer(world.model, height, width)
    exact_ms, bare_ms = Counter[str](), Counter[str]()
    _bare_renders(bare, sequence, 0, Counter())   # both warm up
    sequence.frame(0)
    for start in range(1, frames, _BLOCK):
        block = range(start, min(start + _BLOCK, frames))
        for k in block:
            _bare_renders(bare, sequence, k, bare_ms)
        for k in block:
            exact_ms["picture"] += _ms(lambda k=k: sequence.rgb(k))
            exact_ms["depth and ids"] += _ms(lambda k=k: sequence.truth.frame(k))
            exact_ms["flow and masks"] += _ms(lambda k=k: sequence.truth.flow(k - 1, k))
    bare.close()
    print(f"\n{scene} at {width}x{height}, ms a frame over {frames - 1} frames")
    for name, spent in (*bare_ms.items(), *exact_ms.items()):
        print(f"  {name:20} {spent / (frames - 1):8.1f}")
    plain, exact = bare_ms.total() / (frames - 1), exact_ms.total() / (frames - 1)
    print(f"  bare {plain:.1f}, exact {exact:.1f}: ratio {exact / plain:.2f} (wanted: at most 1.5)")


def _bare_renders(renderer: mujoco.Renderer, sequence: SimulatedSequence, k: int,
                  spent_ms: Counter[str]) -> None:
    data = sequence.truth.world_at(k).data
    for mode in ("colour", "depth", "segmentation"):
        _set_mode(renderer, mode)
        spent_ms[f"bare {mode}"] += _ms(
            lambda: (renderer.update_scene(data, "camera"), renderer.render()))


def _set_mode(renderer: mujoco.Renderer, mode: str) -> None:
    renderer.disable_depth_rendering()
    renderer.disable_segmentation_rendering()
    if mode == "depth":
        renderer.enable_depth_rendering()
    elif mode == "segmentation":
        renderer.enable_segmentation_rendering()


def _ms(step: Callable[[], object]) -> float:
    start = time.perf_counter()
    step()
    return 1e3 * (time.perf_counter() - start)


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
    print(1e3 * (frames - 1) / _ms(lambda: [sequence.frame(k) for k in range(1, frames)]))


if __name__ == "__main__":
    main()
