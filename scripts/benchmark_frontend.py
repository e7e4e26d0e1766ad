"""Error and time of the front end's correspondences on rendered scenes, against exact flow.

    python scripts/benchmark_frontend.py --scene SwingingBoxes-v0 --frames 8 --textures 1 0.1

Points are detected in one frame and matched in the next by every method; the error is that of
points seen in both frames, static points and points on objects apart. "Predicted" flow comes
from depth and the motions of the step before, as a system would have them.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.frontend.flow import (
    DisFlow,
    local_warps,
    predicted_flow,
    round_trip_error,
    sample_flow,
)
from slam.frontend.points import corner_response, detect_points
from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.sampling import bilinear, depth_at, nearest
from slam.frontend.segments import cull_segments, detect_segments
from slam.frontend.support import surface_image
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import FlowField, Intrinsics


@dataclass(frozen=True)
class Pair:
    """Two neighbouring frames with the truth between them."""

    gray: tuple[Array, Array]
    depth_m: Array
    instance_id: Array
    predicted_px: Callable[[], Array]
    flow_px: Array
    visible: Array
    intrinsics: Intrinsics


def pairs(scene: str, seed: int, texture: float, frames: int, step: int) -> Iterator[Pair]:
    """Pairs of frames k, k + 1 of a rendered scene, `step` frames between the pairs."""
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, 2 + frames * step)
    truth = sequence.truth
    for k in range(1, 1 + frames * step, step):
        a, before = truth.frame(k), truth.frame(k - 1)
        flow = truth.flow(k, k + 1)
        T_step = se3.inverse(before.T_world_camera) @ a.T_world_camera
        motions = {}
        for each in truth.layout.objects:
            part = each.root_part
            H = a.T_world_part[part] @ se3.inverse(before.T_world_part[part])
            motions[each.instance_id] = se3.inverse(a.T_world_camera @ T_step) @ H \
                @ a.T_world_camera
        gray = tuple(cv2.cvtColor(sequence.rgb(i), cv2.COLOR_RGB2GRAY) for i in (k, k + 1))

        def predict(a=a, T_step=T_step, motions=motions) -> Array:
            return predicted_flow(a.depth_m, a.instance_id.astype(np.uint8),
                                  se3.inverse(T_step), motions, sequence.intrinsics)

        yield Pair(gray, a.depth_m, a.instance_id, predict, flow.flow_px,
                   flow.valid & ~flow.occluded & ~flow.leaving, sequence.intrinsics)
    renderer.close()


class Clock:
    """Milliseconds of each stage."""

    def __init__(self) -> None:
        self.spent: dict[str, list[float]] = defaultdict(list)

    def __call__(self, stage: str, work: Callable[[], object]) -> object:
        start = time.perf_counter()
        result = work()
        self.spent[stage].append(1e3 * (time.perf_counter() - start))
        return result


class Scores:
    """Errors by method, static points and points on objects apart."""

    def __init__(self) -> None:
        self.errors: dict[tuple[str, str], list[Array]] = defaultdict(list)
        self.used: dict[tuple[str, str], list[Array]] = defaultdict(list)
        self.chi2: dict[tuple[str, str], list[Array]] = defaultdict(list)

    def add(self, method: str, on_object: Array, error: Array, used: Array,
            covariance: Array | None = None) -> None:
        for where, of in (("static", ~on_object), ("object", on_object)):
            self.errors[method, where].append(error[of & used])
            self.used[method, where].append(used[of])
            if covariance is not None:
                e, C = error[of & used], covariance[of & used]
                self.chi2[method, where].append(np.einsum("ni,nij,nj->n", e,
                                                          np.linalg.inv(C), e))

    def print(self) -> None:
        print(f"{'method':40}{'where':8}{'points':>7}{'used':>7}{'median':>8}{'RMSE':>8}"
              f"{'95 %':>8}{'bias':>8}{'chi²/2 median':>15}")
        for (method, where), errors in self.errors.items():
            error = np.concatenate(errors)
            if len(error) == 0:
                continue
            length = np.linalg.norm(error, axis=-1)
            used = np.concatenate(self.used[method, where])
            chi2 = self.chi2.get((method, where))
            # The median of chi² with two degrees of freedom is 2 ln 2.
            shown = f"{np.median(np.concatenate(chi2)) / np.log(4):15.2f}" if chi2 else ""
            print(f"{method:40}{where:8}{len(error):7d}{used.mean():7.1%}{np.median(length):8.4f}"
                  f"{np.sqrt((length ** 2).mean()):8.4f}{np.quantile(length, 0.95):8.4f}"
                  f"{np.linalg.norm(error.mean(axis=0)):8.4f}{shown}")


def measure(pair: Pair, scores: Scores, clock: Clock, config: RefineConfig) -> None:
    """All methods on one pair of frames."""
    previous, current = pair.gray
    uv, _ = clock("detect points",
                  lambda: detect_points(corner_response(previous), 1200, pair.instance_id))
    keep = nearest(pair.visible, uv) & (depth_at(pair.depth_m, uv) > 0)
    uv = uv[keep]
    on_object = nearest(pair.instance_id, uv) > 0
    true = bilinear(pair.flow_px, uv)
    smooth = clock("prepare both images",
                   lambda: (prepare_image(previous, config), prepare_image(current, config)))
    predicted = clock("predict flow", pair.predicted_px)
    warps = clock("local warps", lambda: local_warps(predicted, uv))
    everything = np.ones(len(uv), bool)

    surface = clock("surface image", lambda: surface_image(pair.depth_m, pair.instance_id))

    def refine(name: str, start: Array, A: Array | None, surface: Array | None = None) -> None:
        got = clock(f"refine {len(uv) // 500 * 500}+ points",
                    lambda: refine_matches(*smooth, uv, uv + start, config, A, surface))
        scores.add(name, on_object, got.uv_current - uv - true, got.converged, got.covariance)

    starts = {"prediction": sample_flow(FlowField(predicted), uv, pair.instance_id)[0]}
    for preset in ("fast", "medium"):
        dis = DisFlow(preset)
        raw = clock(f"DIS {preset}", lambda dis=dis: dis(previous, current))
        rest = clock(f"DIS {preset} on the warped image",
                     lambda dis=dis: dis(previous, current, predicted))
        starts[f"DIS {preset}"] = clock("sample flow",
                                        lambda f=raw: sample_flow(f, uv, pair.instance_id))[0]
        starts[f"DIS {preset} after prediction"] = sample_flow(rest, uv, pair.instance_id)[0]
        if preset == "medium":
            back = dis(current, previous)
            checked = round_trip_error(raw, back, uv) < 0.3
            scores.add("DIS medium, round trip < 0.3 px", on_object,
                       starts["DIS medium"] - true, checked)
    for name, start in starts.items():
        scores.add(name, on_object, start - true, everything)
        refine(f"{name}, refined", start, None)
    refine("prediction, refined, warped", starts["prediction"], warps)
    refine("same, patches keep to surface", starts["prediction"], warps, surface)
    for detector in ("lsd", "edge_drawing"):
        found = clock(f"segments: {detector}", lambda d=detector: detect_segments(previous, d))
        clock(f"cull {detector}", lambda s=found: cull_segments(s, pair.depth_m,
                                                                pair.instance_id))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=8, help="pairs of frames")
    parser.add_argument("--step", type=int, default=10, help="frames from pair to pair")
    parser.add_argument("--textures", type=float, nargs="+", default=[1.0, 0.1])
    chosen = parser.parse_args()
    clock = Clock()
    for texture in chosen.textures:
        scores = Scores()
        for pair in pairs(chosen.scene, chosen.seed, texture, chosen.frames, chosen.step):
            measure(pair, scores, clock, RefineConfig())
        print(f"\n{chosen.scene}, seed {chosen.seed}, texture {texture:g}: flow error in px")
        scores.print()
    print(f"\n{'stage':40}{'median ms':>10}")
    for stage, spent in clock.spent.items():
        print(f"{stage:40}{np.median(spent):10.2f}")


if __name__ == "__main__":
    main()
