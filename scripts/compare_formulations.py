"""The global batch object-centric and in the paper's own form, on the same recorded run.

    python scripts/compare_formulations.py [--scene SwingingBoxes-v0] [--frames 30] [--seeds 0 1]
        [--flow dis] [--texture 1.0]

Each sequence is tracked once, with the partial batch; each form of the global batch then starts
from the same record. mm and degrees, means over the seeds; seconds of processor time of the batch.
The second table holds each form against the object-centric one: geometric means of the ratios over
the seeds, with their 95 % intervals.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from itertools import product

import numpy as np
from benchmark_backend import FLOWS, camera_scores, object_scores

from simbench.inputs import Feed
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.statistics import mean_interval
from simbench.world import make_world
from slam.backend.chained import refine_chained
from slam.backend.refine_run import refine_run
from slam.systems.sdpl_batch import SdplBatch

OURS = "object-centric"


def measured(scene: str, seed: int, frames: int, flow: str, texture: float
             ) -> dict[str, dict[str, float]]:
    """Scores of each form on one sequence."""
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    feed = Feed(sequence, replace(FLOWS[flow], masks="truth", depth="sensor", sensor="gaussian"),
                seed)
    system = SdplBatch(sequence.intrinsics)
    owner: dict[tuple[int, int], int] = {}
    for k in range(frames):
        estimate, names = system.process(feed.frame(k)), feed.true_object_of_label(k)
        owner |= {(track, k): names[motion.instance_id]
                  for track, motion in estimate.objects.items() if motion.instance_id in names}
    renderer.close()
    backend, tracked, truth = system.backend, system.tracker.finish(), sequence.truth.trajectories
    forms = {}
    for form, name in (("well_conditioned", OURS), ("paper", f"{OURS}, lines paper")):
        bundle = replace(backend.bundle, line_form=form)
        forms[name] = lambda bundle=bundle: refine_run(system.record, tracked, sequence.intrinsics,
                                                       bundle)
    for form, unit in product(("well_conditioned", "paper"), ("pixels", "metres")):
        chain = replace(backend.chain, line_form=form, measured_in=unit)
        name = f"paper's form, lines {form.replace('_', ' ')}, {unit}"
        forms[name] = lambda chain=chain: refine_chained(
            system.record, tracked, sequence.intrinsics, backend.bundle, chain)
    out = {"before it": camera_scores(tracked, truth) | object_scores(tracked, owner, truth)}
    for name, refined in forms.items():
        refined()                           # compiled, and the machine's caches warm
        start = time.process_time()
        result = refined()
        out[name] = camera_scores(result, truth) | object_scores(result, owner, truth) \
            | {"batch s": time.process_time() - start}
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--flow", choices=sorted(FLOWS), default="dis")
    parser.add_argument("--texture", type=float, default=1.0)
    chosen = parser.parse_args()
    runs = [measured(chosen.scene, seed, chosen.frames, chosen.flow, chosen.texture)
            for seed in chosen.seeds]
    keys = [*runs[0][OURS]]
    _print_head(keys)
    for name in runs[0]:
        values = [np.mean([run[name].get(key, np.nan) for run in runs]) for key in keys]
        print(f"| {name} | " + " | ".join(f"{value:.4g}" for value in values) + " |")
    print()
    _print_head(keys)
    for name in runs[0]:
        if name != OURS:
            print(f"| {name} | " + " | ".join(_ratio(runs, name, key) for key in keys) + " |")


def _print_head(keys: list[str]) -> None:
    print("| | " + " | ".join(keys) + " |\n|---" + "|---" * len(keys) + "|")


def _ratio(runs: list[dict[str, dict[str, float]]], name: str, key: str) -> str:
    """Of one form to ours, over the seeds that have both."""
    logs = [np.log(run[name][key] / run[OURS][key]) for run in runs
            if key in run[name] and np.isfinite(run[name][key] / run[OURS][key])]
    if not logs:
        return ""
    found = mean_interval(logs)
    mean = f"{np.exp(found.mean):.2f}"
    if found.low is None or found.high is None:
        return mean
    return f"{mean} ({np.exp(found.low):.2f} to {np.exp(found.high):.2f})"


if __name__ == "__main__":
    main()
