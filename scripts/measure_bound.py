"""How far tracking is from what its correspondences allow: RMS errors over the Cramér–Rao bound.

    python scripts/measure_bound.py [--scene SwingingBoxes-v0] [--seeds 0 1 2 3 4] [--frames 60]
        [--system sdpl] [--objects]

True flow with pairwise, isotropic, Gaussian noise of 0.3 px everywhere (no
heavier tail), depth with Gaussian noise of 0.002 z² in both frames. Two bounds are printed:

    cells    the correspondences that the tracker uses: means over the cells of its grid. A cell of
             n pixels has the noise σ / √n in its flow and in both its inverse depths. Corners and
             segments carry no noise of their own here: they read the same flow.
    pixels   every pixel that truly stays visible on its own body, one correspondence each.

Geometry, visibility and whose pixel it is are the truth's (simbench.metrics.bound).
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

import slam
from simbench.inputs import Feed, InputChoice
from simbench.metrics.bound import (
    TrueCorrespondences,
    motion_information,
    object_motion_covariance,
)
from simbench.metrics.camera import camera_step_errors
from simbench.metrics.efficiency import CAMERA, GaussianNoise, true_step, visible_pixels
from simbench.render import make_renderer
from simbench.run import run
from simbench.score import Online
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.frontend.grid import grid_matches
from slam.frontend.observe import Observation, observe
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import PointMatches
from slam.systems.registry import PRESETS, default_config
from slam.types import Frame, FrameEstimate

FLOW_SIGMA_PX = 0.3
INVERSE_DEPTH_SIGMA = 0.002      # σ_z = 0.002 z² is this in 1/z
NOISE = GaussianNoise(FLOW_SIGMA_PX, INVERSE_DEPTH_SIGMA)
BOUNDS = ("cells", "pixels")
WANTED = {"camera": 1.5, "objects": 2.0}


@dataclass(slots=True)
class Squares:
    """Squared errors and bounds of translation (m²) and rotation (deg²), one for each motion."""

    error: list[tuple[float, float]] = field(default_factory=list)
    bound: dict[str, list[tuple[float, float]]] = field(
        default_factory=lambda: {name: [] for name in BOUNDS})

    def add(self, t_m: float, r_deg: float, covariances: dict[str, Array]) -> None:
        self.error.append((t_m**2, r_deg**2))
        for name, P in covariances.items():
            self.bound[name].append((float(np.trace(P[3:, 3:])),
                                     float(np.trace(P[:3, :3])) * np.degrees(1.0) ** 2))

    def ratios(self, bound: str) -> Array:
        """(2,) RMS error over RMS bound: translation, rotation."""
        return np.sqrt(np.mean(self.error, axis=0) / np.mean(self.bound[bound], axis=0))


class Informant:
    """Watches a run and works out each pair of frames' information, body by body."""

    def __init__(self, sequence: SimulatedSequence, feed: Feed, system: str) -> None:
        self.sequence, self.feed, self.config = sequence, feed, default_config(system)
        self.information: dict[str, dict[int, dict[int, Array]]] = {name: {} for name in BOUNDS}
        self._previous: Observation | None = None

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        current = observe(frame)
        if self._previous is not None:
            k, truth = frame.index, self.sequence.truth
            pixels = visible_pixels(truth, k, NOISE)
            bodies = (self._cells(self._previous, current, k),
                      {body: seen for body, (seen, _) in pixels.items()})
            for name, found in zip(BOUNDS, bodies, strict=True):
                self.information[name][k] = {
                    body: motion_information(true_step(truth.trajectories, body, k), seen,
                                             self.sequence.intrinsics)
                    for body, seen in found.items()}
        self._previous = current

    def _cells(self, a: Observation, b: Observation, k: int) -> dict[int, TrueCorrespondences]:
        """The tracker's own correspondences, with the numbers of true objects as groups."""
        flow = b.frame.flow
        assert flow is not None
        groups = [o.groups(self.feed.true_object_of_label(i)) for o, i in ((a, k - 1), (b, k))]
        cells = grid_matches(flow, a.rho, b.rho, *groups, self.config.grid, self.config.noise)
        pixels = self.config.noise.flow_sigma_px**2 / cells.flow_cov[:, 0, 0]
        rho_a = _true_inverse_depth(self.sequence.truth.frame(k - 1).depth_m, cells)
        sigma_rho = INVERSE_DEPTH_SIGMA / np.sqrt(pixels)
        sigma_b = np.where(np.isfinite(cells.rho_sigma_b), sigma_rho, np.inf)
        return {int(g): TrueCorrespondences(
                    cells.uv_a[own], rho_a[own], FLOW_SIGMA_PX / np.sqrt(pixels[own]),
                    sigma_rho[own], sigma_b[own])
                for g in np.unique(cells.group) for own in [cells.group == g]}


def _true_inverse_depth(depth_m: Array, cells: PointMatches) -> Array:
    """(N,) at the cells' centres; where another surface lies just there, the measured mean."""
    column, row = np.rint(cells.uv_a).astype(np.int64).T
    rho = np.divide(1.0, depth_m[row, column], out=np.zeros(len(cells)),
                    where=depth_m[row, column] > 0)
    return np.where(np.abs(rho - cells.rho_a) < 0.1 * cells.rho_a, rho, cells.rho_a)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", default="SwingingBoxes-v0")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--system", default="sdpl", choices=sorted(PRESETS))
    parser.add_argument("--objects", action="store_true", help="each object by itself, too")
    chosen = parser.parse_args(arguments)
    pooled: dict[str, Squares] = defaultdict(Squares)
    print("RMS error over the bound: translation, rotation\n")
    print("| seed | of | motions | RMS mm | RMS ° | over cells | over pixels |")
    print("|---|---|---|---|---|---|---|")
    for seed in chosen.seeds:
        found = _measured(chosen.scene, seed, chosen.frames, chosen.system, pooled)
        for name, squares in found.items():
            if chosen.objects or not name.startswith("object "):
                _print_row(str(seed), name, squares)
    for name, limit in WANTED.items():
        _print_row("all", f"{name} (wanted ≤ {limit:g})", pooled[name])


def _print_row(seed: str, name: str, squares: Squares) -> None:
    t, r = np.sqrt(np.mean(squares.error, axis=0))
    ratios = ("{:.2f}, {:.2f}".format(*squares.ratios(bound)) for bound in BOUNDS)
    print(f"| {seed} | {name} | {len(squares.error)} | {1e3 * t:.4f} | {r:.5f} | "
          + " | ".join(ratios) + " |", flush=True)


def _measured(scene: str, seed: int, frames: int, system: str, pooled: dict[str, Squares]
              ) -> dict[str, Squares]:
    world = make_world(scene, seed)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    feed = Feed(sequence, InputChoice(
        flow="noisy", flow_sigma_px=FLOW_SIGMA_PX, flow_noise_kind="pairwise",
        flow_noise_shape="isotropic", depth="sensor", sensor="gaussian", masks="truth",
        sensor_settings={"flow.occluded_share": 0.0}), seed)
    informant = Informant(sequence, feed, system)
    record = run(slam.make(system, feed.intrinsics), feed, observers=(informant,))
    truth, online = sequence.truth.trajectories, Online.of(record)
    renderer.close()
    out: dict[str, Squares] = defaultdict(Squares)
    steps = camera_step_errors(online.camera, truth)
    for k, t_m, r_deg in zip(steps.frame, steps.t_m, steps.r_deg, strict=True):
        bounds = {name: np.linalg.inv(of[int(k)][CAMERA])
                  for name, of in informant.information.items()}
        for squares in (out["camera"], pooled["camera"]):
            squares.add(t_m, r_deg, bounds)
    for body, errors in online.object_errors(truth, exact=True).items():
        L, X = truth.objects[body].T_world_object, truth.T_world_camera
        for k, t_m, r_deg in zip(errors.frame, errors.local_t_m, errors.local_r_deg, strict=True):
            here = {name: of[int(k)] for name, of in informant.information.items()}
            if not all(body in of for of in here.values()):
                continue   # nothing of it is visible in both frames: there is no bound
            bounds = {name: object_motion_covariance(se3.inverse(L[k]) @ X[k], of[CAMERA], of[body])
                      for name, of in here.items()}
            for squares in (out["objects"], out[f"object {errors.name}"], pooled["objects"]):
                squares.add(t_m, r_deg, bounds)
    return out


if __name__ == "__main__":
    main()
