"""Accuracy of tracking on simulated sequences: systems × inputs, mean and 95 % over the seeds.

    python scripts/measure_tracking.py [--scenes SwingingBoxes-v0 Street-v0] [--seeds 0 1 2 3 4]
        [--frames 60] [--systems sdpl sdpl-no-flow-opt vdo] [--workers 1] [--per-seed]

Each sequence is rendered once for each seed and texture and given to all systems. Inputs:

    given    true flow with Gaussian noise of 0.3 px, depth with Gaussian noise of 0.002 z² m
    exact    true flow and true depth
    images   flow estimated from the images (DIS), depth noise as in `given`
    images, texture 0.1    the same with a tenth of the scene's texture contrast

Prints a table for each scene, errors as means over frames (EQUATIONS 7): camera, then objects,
and beside them what the published programs reach on comparable sequences.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np
from scipy import stats

import slam
from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.run import RunRecord, run, score
from simbench.score import Online
from simbench.simulate import SimulatedSequence
from simbench.types import Trajectories
from simbench.world import make_world

FLOW_SIGMA_PX = 0.3


@dataclass(frozen=True, slots=True)
class Condition:
    """Inputs that the systems are given, and the texture of the scene they are taken from."""

    name: str
    choice: InputChoice
    texture: float = 1.0


NOISY_DEPTH = {"depth": "sensor", "sensor": "gaussian", "masks": "truth"}
CONDITIONS = (
    Condition("given", InputChoice(flow="noisy", flow_sigma_px=FLOW_SIGMA_PX, **NOISY_DEPTH)),
    Condition("exact", InputChoice(flow="truth", depth="truth", masks="truth")),
    Condition("images", InputChoice(flow="dis", **NOISY_DEPTH)),
    Condition("images, texture 0.1", InputChoice(flow="dis", **NOISY_DEPTH), texture=0.1),
)

# Camera mm, objects mm, objects degrees a frame of the published programs on comparable
# sequences (640×480, boxes at 2–7 m); flow from images: the better of SDPL-SLAM and VDO-SLAM.
PUBLISHED = {
    ("SwingingBoxes-v0", "exact"): (0.17, 0.06, None),
    ("SwingingBoxes-v0", "images"): (0.5, 2.2, 0.16),
    ("SwingingBoxes-v0", "images, texture 0.1"): (1.5, 3.1, 0.18),
}
WANTED = {   # no more than
    ("SwingingBoxes-v0", "exact"): (0.05, 0.05, None),
    ("SwingingBoxes-v0", "images"): (0.33, 1.47, 0.107),
    ("SwingingBoxes-v0", "images, texture 0.1"): (1.0, 2.07, 0.12),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One system on one sequence with one kind of input."""

    scene: str
    seed: int
    condition: str
    system: str
    metrics: dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=["SwingingBoxes-v0", "Street-v0"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--systems", nargs="+", default=["sdpl", "sdpl-no-flow-opt", "vdo"])
    parser.add_argument("--conditions", nargs="+", default=[c.name for c in CONDITIONS],
                        choices=[c.name for c in CONDITIONS], metavar="NAME")
    parser.add_argument("--workers", type=int, default=1, help="sequences worked on at a time")
    parser.add_argument("--per-seed", action="store_true", help="each seed's means, too")
    chosen = parser.parse_args(arguments)
    rows = list(_measured(chosen))
    for scene in chosen.scenes:
        of_scene = [row for row in rows if row.scene == scene]
        print(f"\n{scene}, seeds {' '.join(map(str, chosen.seeds))}, {chosen.frames} frames: "
              "mean over the seeds ± half of its 95 % interval\n")
        _print_table(of_scene, chosen.conditions, chosen.systems)
        if chosen.per_seed:
            _print_seeds(of_scene)


def _measured(chosen: argparse.Namespace) -> Iterable[Row]:
    """All rows; one task renders one sequence and runs everything on it."""
    textures = sorted({c.texture for c in CONDITIONS if c.name in chosen.conditions}, reverse=True)
    tasks = [(scene, seed, texture, chosen.frames, tuple(chosen.systems), tuple(chosen.conditions),
              max(1, (os.cpu_count() or 1) // chosen.workers))
             for scene in chosen.scenes for seed in chosen.seeds for texture in textures]
    if chosen.workers == 1:
        for task in tasks:
            yield from _noted(_rows_of_sequence(*task))
        return
    with ProcessPoolExecutor(chosen.workers, mp_context=get_context("spawn")) as pool:
        for rows in pool.map(_rows_of_sequence, *zip(*tasks, strict=True)):
            yield from _noted(rows)


def _noted(rows: list[Row]) -> list[Row]:
    """A line of progress for each sequence that is done."""
    first = rows[0]
    print(f"{first.scene} seed {first.seed}: {', '.join(dict.fromkeys(r.condition for r in rows))}",
          file=sys.stderr, flush=True)
    return rows


def _rows_of_sequence(scene: str, seed: int, texture: float, frames: int,
                      systems: Sequence[str], conditions: Sequence[str], threads: int) -> list[Row]:
    os.environ["LP_NUM_THREADS"] = str(threads)   # Mesa's software rasteriser takes all otherwise
    cv2.setNumThreads(threads)
    world = make_world(scene, seed, {"texture": texture})
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames, kept=frames)
    truth = sequence.truth.trajectories
    rows = []
    for condition in CONDITIONS:
        if condition.name not in conditions or condition.texture != texture:
            continue
        for name in systems:
            record = run(slam.make(name, sequence.intrinsics),
                         Feed(sequence, condition.choice, seed))
            for line in record.log:
                print(f"{scene} seed {seed}, {condition.name}, {name}: {line}", file=sys.stderr)
            metrics = score(truth, record)
            metrics["objects"]["mean"] |= _median_error(truth, record)
            rows.append(Row(scene, seed, condition.name, name, metrics))
    renderer.close()
    return rows


def _median_error(truth: Trajectories, record: RunRecord) -> dict[str, float]:
    """Beside the mean, which a car of 200 pixels at 35 m decides."""
    errors = Online.of(record).object_errors(truth, exact=True).values()
    t_m = np.concatenate([np.zeros(0), *(e.t_m for e in errors if e.rigid)])
    return {"E_t_median": float(np.median(t_m))} if len(t_m) else {}


COLUMNS = (   # heading, block and key of metrics.json, factor, format
    ("camera E_t mm", ("camera", "E_t"), 1e3, ".3f"),
    ("camera E_R °", ("camera", "E_R"), 1.0, ".4f"),
    ("coverage", ("camera", "coverage"), 1.0, ".3f"),
    ("objects E_t mm", ("objects", "mean", "E_t"), 1e3, ".3f"),
    ("its median mm", ("objects", "mean", "E_t_median"), 1e3, ".3f"),
    ("objects E_R °", ("objects", "mean", "E_R"), 1.0, ".4f"),
    ("coverage", ("objects", "mean", "coverage"), 1.0, ".3f"),
    ("id switches", ("objects", "mean", "id_switches"), 1.0, ".1f"),
    ("false motions", ("objects", "mean", "false_motions"), 1.0, ".1f"),
)


def _print_table(rows: list[Row], conditions: Sequence[str], systems: Sequence[str]) -> None:
    print("| input | system | " + " | ".join(heading for heading, *_ in COLUMNS) + " |")
    print("|---|---|" + "---|" * len(COLUMNS))
    for condition in conditions:
        for system in systems:
            chosen = [r for r in rows if (r.condition, r.system) == (condition, system)]
            cells = [_with_interval([_value(r.metrics, path) * factor for r in chosen], form)
                     for _, path, factor, form in COLUMNS]
            print(f"| {condition} | {system} | " + " | ".join(cells) + " |")
        for label, table in (("published programs", PUBLISHED), ("wanted: at most", WANTED)):
            figures = table.get((rows[0].scene, condition))
            if figures:
                camera, objects, degrees = ("" if f is None else f"{f:g}" for f in figures)
                print(f"| {condition} | *{label}* | {camera} | | | {objects} | | {degrees} | | | |")


def _print_seeds(rows: list[Row]) -> None:
    print()
    for row in rows:
        values = [f"{heading} {_value(row.metrics, path) * factor:{form}}"
                  for heading, path, factor, form in COLUMNS]
        print(f"seed {row.seed}, {row.condition}, {row.system}: " + ", ".join(values))


def _value(metrics: dict[str, Any], path: Sequence[str]) -> float:
    """A figure of metrics.json; NaN where it does not apply."""
    node: Any = metrics
    for key in path:
        if key not in node:
            return float("nan")
        node = node[key]
    return float(node)


def _with_interval(values: Sequence[float], form: str) -> str:
    """Mean ± half of its 95 % interval by Student's t over the seeds."""
    known = np.array([v for v in values if np.isfinite(v)])
    if not len(known):
        return "–"
    text = f"{known.mean():{form}}"
    if len(known) > 1 and known.std() > 0:
        half = stats.t.ppf(0.975, len(known) - 1) * known.std(ddof=1) / np.sqrt(len(known))
        text += f" ± {half:{form}}"
    return text + (f" ({len(known)} of {len(values)} seeds)" if len(known) < len(values) else "")


if __name__ == "__main__":
    main()
