"""Object tracks under missed masks: identity switches, coverage and errors over the share missed.

    python scripts/measure_object_tracks.py [--scenes SwingingBoxes-v0 Street-v0] [--seeds 0 1 2]
        [--frames 30] [--missed 0 0.1 0.3] [--system sdpl]

True flow with noise of 0.3 px, depth with Gaussian noise of 0.002 z², masks one pixel too small
with labels shuffled in every frame, and each object missing from a frame's masks at random with the
probability given. Counts are sums over the seeds, errors means over all motions of all seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

import slam
from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.run import run, score
from simbench.score import Online
from simbench.simulate import SimulatedSequence
from simbench.world import make_world


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["SwingingBoxes-v0", "Street-v0"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--missed", type=float, nargs="+", default=[0.0, 0.1, 0.3])
    parser.add_argument("--system", default="sdpl")
    chosen = parser.parse_args(arguments)
    print("| scene | masks missed | identity switches | tracks | motions of all | false motions | "
          "E_t mm | median mm |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in chosen.scenes:
        found: dict[float, list[tuple[dict[str, float], np.ndarray, int]]] = {}
        for seed in chosen.seeds:
            world = make_world(scene, seed)
            renderer = make_renderer("mujoco", world)
            sequence = SimulatedSequence(world, renderer, chosen.frames, kept=chosen.frames)
            for missed in chosen.missed:
                found.setdefault(missed, []).append(_one(sequence, seed, missed, chosen.system))
            renderer.close()
        for missed, rows in found.items():
            total = {key: sum(row[0].get(key, 0) for row in rows)
                     for key in ("id_switches", "frames", "moving", "false_motions")}
            errors = 1e3 * np.concatenate([row[1] for row in rows])
            print(f"| {scene} | {missed:.0%} | {total['id_switches']:.0f} | "
                  f"{sum(row[2] for row in rows)} | {total['frames']:.0f} of "
                  f"{total['moving']:.0f} | {total['false_motions']:.0f} | {errors.mean():.2f} | "
                  f"{np.median(errors):.2f} |", flush=True)


def _one(sequence: SimulatedSequence, seed: int, missed: float, system: str
         ) -> tuple[dict[str, float], np.ndarray, int]:
    """The `objects.mean` block with the motions there were, all errors in m, number of tracks."""
    feed = Feed(sequence, InputChoice(
        flow="noisy", flow_sigma_px=0.3, depth="sensor", sensor="gaussian", masks="noisy",
        sensor_settings={"masks.missed": missed}), seed)
    record = run(slam.make(system, feed.intrinsics), feed)
    truth = sequence.truth.trajectories
    online = Online.of(record)
    errors = [e for e in online.object_errors(truth, exact=True).values() if e.rigid]
    block = dict(score(truth, record)["objects"]["mean"])
    block["moving"] = sum(int(e.moving.sum()) for e in errors)
    return block, np.concatenate([e.t_m for e in errors]), len(online.owner)


if __name__ == "__main__":
    main()
