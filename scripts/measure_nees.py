"""Do the covariances of single motions match their errors, over scenes and seeds?

    python scripts/measure_nees.py --scenes SwingingBoxes-v0 Street-v0 --seeds 0 1 2

NEES of camera and objects (6 is right), with the 95 % bounds of as many independent ones, over all
seeds. Depth has Gaussian noise of 0.002 z²; flow is estimated from the images (`dis`), or given
with pairwise Gaussian noise of 0.3 px (`noisy`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

import slam
from simbench.inputs import Feed, InputChoice
from simbench.metrics.consistency import camera_nees, nees_bounds, object_nees
from simbench.render import make_renderer
from simbench.run import run
from simbench.score import Online
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.geometry.arrays import Array

FLOWS = {"dis": {"flow": "dis"},
         "noisy": {"flow": "noisy", "flow_sigma_px": 0.3, "flow_noise_kind": "pairwise",
                   "flow_noise_shape": "isotropic",
                   "sensor_settings": {"flow.occluded_share": 0.0}}}


def measured(scene: str, seed: int, frames: int, flow: str, texture: float, system: str
             ) -> tuple[Array, Array]:
    """NEES of the camera's and of the objects' motions in one run."""
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    feed = Feed(sequence, InputChoice(masks="truth", depth="sensor", sensor="gaussian",
                                      **FLOWS[flow]), seed)
    online = Online.of(run(slam.make(system, feed.intrinsics), feed))
    renderer.close()
    truth = sequence.truth.trajectories
    return (camera_nees(online.camera, truth, np.arange(1, frames)),
            object_nees(online.motions, online.object_errors(truth, exact=True), truth))


def row(values: Array) -> str:
    """Mean, median and bounds of finite NEES."""
    values = values[np.isfinite(values)]
    if not len(values):
        return "| | | "
    low, high = nees_bounds(len(values))
    return f"| {values.mean():.2f} | {np.median(values):.2f} | {low:.2f} to {high:.2f} "


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["SwingingBoxes-v0"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--frames", type=int, default=25)
    parser.add_argument("--flow", choices=sorted(FLOWS), default="dis")
    parser.add_argument("--texture", type=float, default=1.0)
    parser.add_argument("--system", default="sdpl")
    chosen = parser.parse_args(arguments)
    print("| scene | camera | median | 95 % | objects | median | 95 % |")
    print("|---|---|---|---|---|---|---|")
    for scene in chosen.scenes:
        runs = [measured(scene, seed, chosen.frames, chosen.flow, chosen.texture, chosen.system)
                for seed in chosen.seeds]
        camera, objects = (np.concatenate(part) for part in zip(*runs, strict=True))
        print(f"| {scene} {row(camera)}{row(objects)}|", flush=True)


if __name__ == "__main__":
    main()
