"""What is there to gain from long tracks, where flow noise belongs to places in frames?

    python scripts/measure_localisation.py --seeds 0 1 2 3 4

Tracking alone on flow with localisation noise, on the same with exact depth, and on exact flow with
noisy depth: what no smoothing of the flow can get below. Then the tracked steps: how their errors
hang together from one to the next. Where a frame's noise enters the step to it and the step from it
with opposite signs, the path does not add it up, and there is nothing for a batch to average.
"""

from __future__ import annotations

import argparse

import numpy as np
from benchmark_backend import camera_scores

from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.sdpl import SdplSlam

CASES = {"flow noise and depth noise": ("noisy", "gaussian"),
         "flow noise alone": ("noisy", "ideal"),
         "depth noise alone": ("truth", "gaussian")}


def tracked(scene: str, seed: int, frames: int, flow: str, sensor: str, kind: str
            ) -> tuple[dict[str, float], Array]:
    """Scores, and errors (K − 1, 6) of the steps in rad and m."""
    world = make_world(scene, seed)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    feed = Feed(sequence, InputChoice(
        flow=flow, flow_noise_kind=kind, flow_sigma_px=0.3, masks="truth", depth="sensor",
        sensor=sensor), seed)
    system = SdplSlam(sequence.intrinsics)
    for k in range(frames):
        system.process(feed.frame(k))
    renderer.close()
    result, truth = system.finish(), sequence.truth.trajectories
    T, T_true = result.T_world_camera, truth.T_world_camera[:frames]
    steps, true = (se3.inverse(X[:-1]) @ X[1:] for X in (T, T_true))
    return camera_scores(result, truth), se3.log(se3.inverse(true) @ steps)


def shape(errors: Array) -> tuple[float, float, float]:
    """Of steps' errors (K, 6): correlation with the next one, and RMS and mean length in mm."""
    t = 1e3 * errors[:, 3:]
    centred = t - t.mean(axis=0)
    following = float(np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2))
    return following, float(np.sqrt(np.mean(np.sum(t**2, axis=1)))), float(
        np.linalg.norm(t.mean(axis=0)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--frames", type=int, default=45)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--kind", choices=["localisation", "pairwise"], default="localisation")
    chosen = parser.parse_args()
    print("| | ATE mm | RPE 1 s mm | step RMS mm | mean step error mm | lag-1 correlation |")
    print("|---|---|---|---|---|---|")
    for name, (flow, sensor) in CASES.items():
        runs = [tracked(chosen.scene, seed, chosen.frames, flow, sensor, chosen.kind)
                for seed in chosen.seeds]
        following, rms, mean = np.mean([shape(errors) for _, errors in runs], axis=0)
        ate, rpe = (np.mean([scores[key] for scores, _ in runs]) for key in ("ATE", "RPE 1 s"))
        print(f"| {name} | {ate:.4f} | {rpe:.4f} | {rms:.4f} | {mean:.4f} | {following:+.2f} |",
              flush=True)


if __name__ == "__main__":
    main()
