"""Memory of an environment over many steps with resets at random, and OpenGL contexts left open.

    python scripts/measure_memory.py --steps 10000

Resident memory is read at every hundredth part, after the first fifth, with what is free given
back to the system; flat is where the last fifth of the readings is within ± 5 % of the first fifth.
Contexts are counted where they are made and freed.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import sys

import gymnasium
import numpy as np
import psutil

import simbench  # noqa: F401 (registers the environments)
from simbench.envs import BUILTIN_SCENES
from simbench.render import gl

READINGS = 100
WARM_UP = 0.2           # share of the steps in which caches fill
FLAT = 0.05


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--scenes", nargs="+", default=list(BUILTIN_SCENES))
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(words)
    contexts = OpenContexts()
    print("| environment | steps | resets | MB at first | MB at last | most MB | end / begin "
          "| contexts open |")
    print("|---|---|---|---|---|---|---|---|")
    flat = True
    for scene in chosen.scenes:
        mb, resets = _walked(scene, chosen.steps, np.random.default_rng(chosen.seed))
        fifth = max(1, len(mb) // 5)
        ratio = float(np.median(mb[-fifth:]) / np.median(mb[:fifth]))
        flat &= abs(ratio - 1.0) <= FLAT and contexts.open == 0
        print(f"| {scene} | {chosen.steps} | {resets} | {mb[0]:.0f} | {mb[-1]:.0f} | "
              f"{max(mb):.0f} | {ratio:.3f} | {contexts.open} |", flush=True)
    return 0 if flat else 1


class OpenContexts:
    """Counts the OpenGL contexts that are made here and not freed."""

    def __init__(self) -> None:
        self.open = 0
        make = gl.make_context

        def counted(width: int, height: int) -> object:
            context = make(width, height)
            self.open += 1
            free, alive = context.free, [context]

            def freed() -> None:
                if alive:            # its destructor frees it once more
                    alive.clear()
                    self.open -= 1
                free()

            context.free = freed
            return context

        gl.make_context = counted
        for module in list(sys.modules.values()):      # those that imported it by name
            if getattr(module, "make_context", None) is make:
                module.make_context = counted


def _give_back() -> None:
    """What is free goes back to the system, also what glibc keeps: some 100 MB after resets."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def _walked(scene: str, steps: int, chance: np.random.Generator) -> tuple[list[float], int]:
    """Resident MB while an environment is stepped, and how often it was reset."""
    process, mb, resets = psutil.Process(), [], 0
    env = gymnasium.make(f"simbench/{scene}", size=(64, 48), frames=50, sensor="kinect")
    over = True
    every = max(1, steps // READINGS)
    for number in range(steps):
        if over or chance.random() < 0.02:
            env.reset(seed=int(chance.integers(2**31)))
            resets += 1
        *_, over, _ = env.step(chance.uniform(-1, 1, 6).astype(np.float32))
        if number >= WARM_UP * steps and number % every == 0:
            _give_back()
            mb.append(process.memory_info().rss / 1e6)
    env.close()
    return mb, resets


if __name__ == "__main__":
    sys.exit(main())
