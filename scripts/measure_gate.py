"""What a gate catches, and how often it cries wolf: `smoke` over many fresh sets of seeds.

    python scripts/measure_gate.py --out DIR [--sets 20] [--frames 8] [--workers 2]

Each set has three seeds of its own. Its baseline is of `sdpl`; held against it are `sdpl` itself,
`sdpl` that is given other last bits (as another processor or Mesa would draw them), and `sdpl`
whose camera motions are made about 10 % worse by noise.
Prints how many of the sets pass, and by how much E_t is really worse.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from simbench.baseline import Baseline, outcome_of
from simbench.gate import judge
from simbench.suites.files import load_suite
from simbench.suites.run_suite import Where, run_suite
from slam.geometry import se3
from slam.systems.registry import SlamSystem, make
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult

_SEEDS_A_SET = 3
# Noise in m that makes E_t a tenth larger on boxes with flow given, with flow from the images, and
# on the street.
_WORSE_M = {"given": 0.069e-3, "images": 0.17e-3, "street": 0.235e-3}
_STREET_M = 8.0           # median depth beyond which it is the street
_OTHER_BITS = 0.01        # share of pixels whose last bit is another


class OtherLastBits:
    """`sdpl` on pictures of which a few pixels differ by one grey level."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._inner: SlamSystem = make("sdpl", intrinsics)

    def process(self, frame: Frame) -> FrameEstimate:
        rng = np.random.default_rng(frame.index)
        flips = (rng.random(frame.rgb.shape) < _OTHER_BITS).astype(np.uint8)
        depth_m = frame.depth_m * (1.0 + 1e-6 * rng.standard_normal(frame.depth_m.shape))
        return self._inner.process(replace(frame, rgb=frame.rgb ^ flips,
                                           depth_m=depth_m.astype(np.float32)))

    def finish(self) -> SlamResult:
        return self._inner.finish()


class WorseCamera:
    """`sdpl` with noise on the translation of every camera motion."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._inner: SlamSystem = make("sdpl", intrinsics)
        self._rng = np.random.default_rng(0)
        self._T_world_camera = np.eye(4)

    def process(self, frame: Frame) -> FrameEstimate:
        estimate = self._inner.process(frame)
        if np.median(frame.depth_m) > _STREET_M:
            place = "street"
        else:
            place = "given" if frame.flow is not None else "images"
        direction = self._rng.standard_normal(3) * (frame.index > 0)
        shift = _WORSE_M[place] * direction / max(1e-9, np.linalg.norm(direction))
        step = estimate.T_previous_camera @ se3.from_rotation_translation(np.eye(3), shift)
        self._T_world_camera = self._T_world_camera @ step
        return replace(estimate, T_previous_camera=step, T_world_camera=self._T_world_camera)

    def finish(self) -> SlamResult:
        return self._inner.finish()


SYSTEMS = ("sdpl", f"{Path(__file__)}:OtherLastBits", f"{Path(__file__)}:WorseCamera")


def of_seeds(found: Baseline, system: str, seeds: Sequence[int]) -> Baseline:
    """The runs of one system and some seeds, the system called `sdpl`."""
    runs = tuple(replace(run, system="sdpl") for run in found.runs
                 if run.system == system and run.seed in seeds)
    return replace(found, runs=runs)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args(arguments)
    sets = [range(i, i + _SEEDS_A_SET) for i in range(0, _SEEDS_A_SET * given.sets, _SEEDS_A_SET)]
    suite = load_suite("smoke").changed(systems=SYSTEMS, frames=given.frames,
                                        seeds=tuple(range(_SEEDS_A_SET * given.sets)))
    run_suite(suite, given.out, Where(given.workers, reports="none"), resume=True,
              on_run=lambda done: print(f"\r{done} runs", end="", file=sys.stderr, flush=True))
    found = outcome_of(given.out)
    print("| held against the baseline of sdpl | sets that pass | camera E_t worse by |")
    print("|---|---|---|")
    for system in SYSTEMS:
        verdicts = [judge(of_seeds(found, "sdpl", seeds), of_seeds(found, system, seeds))
                    for seeds in sets]
        passed = sum(verdict.passed for verdict in verdicts)
        print(f"| {system.rpartition(':')[2]} | {passed} of {len(sets)} | "
              f"{_worse_by(found, system)} |")
        for verdict in verdicts:
            for change in verdict.regressions if system != SYSTEMS[2] else ():
                print(f"  {change}", file=sys.stderr)


def _worse_by(found: Baseline, system: str) -> str:
    metric = next(m for m in found.metrics if m.name == "camera.E_t")
    values = {name: {(run.case, repr(run.point), run.seed): run.values[metric.name]
                     for run in found.runs if run.system == name} for name in ("sdpl", system)}
    worse = 100.0 * np.array([metric.worsening(old, values[system][key])
                              for key, old in values["sdpl"].items()])
    return f"{worse.mean():+.1f} %, ± {worse.std():.1f} from sequence to sequence"


if __name__ == "__main__":
    main()
