"""DPL-SLAM among people: Office-v0 with each of TUM's camera motions, against the static baseline.

    python scripts/measure_dpl.py [--seeds 0 1 2 3 4] [--frames 90] [--cases walking none]
        [--systems orb dpl] [--motions xyz static rpy halfsphere] [--set STAGE.FIELD=VALUE]

Cases: `walking` people, `sitting` ones, `none`, and `undetected`: walking ones and a box without a
mask that is kicked to and fro. Colour and depth as of a Kinect, boxes of the true masks (or
`--boxes noisy`). Each sequence is rendered once and given to all systems.

Prints a row for each sequence and system: ATE RMSE and RPE over 1 frame of the poses as they were
returned, coverage, precision and recall of what was judged to move; how much of the image people
cover and in how many frames that is between 20 % and 50 %; then means over the seeds; then ratios
of pairs of equal sequences, geometric means with their 95 % intervals: every system to the first
one, and every case to the first one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from simbench.inputs import Feed, InputChoice
from simbench.load_system import load_system
from simbench.metrics.culling import CullingErrors
from simbench.render import make_renderer
from simbench.run import run, score
from simbench.simulate import SimulatedSequence
from simbench.statistics import mean_interval
from simbench.world import make_world

CASES: dict[str, dict[str, float | str]] = {
    "walking": {"people": "walking"}, "none": {"people": "none"},
    "sitting": {"people": "sitting"}, "undetected": {"people": "walking", "undetected": 1}}
MOTIONS = ("xyz", "static", "rpy", "halfsphere")
COVERED = (0.2, 0.5)     # of the image, by people


@dataclass(frozen=True, slots=True)
class Row:
    case: str
    motion: str
    seed: int
    system: str
    ate_mm: float
    rpe_mm: float
    coverage: float
    precision: float
    recall: float
    people: float            # mean share of the image
    crowded: float           # share of the frames in which it is within COVERED


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--frames", type=int, default=90)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=["walking", "none"])
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--systems", nargs="+", default=["orb", "dpl"])
    parser.add_argument("--boxes", choices=("truth", "noisy", "none"), default="truth")
    parser.add_argument("--size", default=None, help="WxH; the scene's own by default")
    parser.add_argument("--set", dest="settings", action="append", default=[],
                        metavar="STAGE.FIELD=VALUE", help="a setting of dpl")
    chosen = parser.parse_args(arguments)
    print("| case | camera | seed | system | ATE mm | RPE 1 frame mm | coverage | precision | "
          "recall | people | 20–50 % |\n|---|---|---|---|---|---|---|---|---|---|---|")
    rows = []
    for case in chosen.cases:
        for motion in chosen.motions:
            for seed in chosen.seeds:
                for row in _rows_of_sequence(case, motion, seed, chosen):
                    rows.append(row)
                    _print(row)
    _print_means(rows, chosen)
    _print_ratios(rows, chosen)


def _rows_of_sequence(case: str, motion: str, seed: int, chosen: argparse.Namespace
                      ) -> Iterator[Row]:
    size = tuple(int(n) for n in chosen.size.split("x")) if chosen.size else None
    world = make_world("Office-v0", seed, CASES[case] | {"camera_motion": motion}, size)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, chosen.frames, kept=chosen.frames)
    truth = sequence.truth.trajectories
    choice = InputChoice(flow="dis", masks="none", boxes=chosen.boxes, sensor="kinect")
    for name in chosen.systems:
        feed, culling = Feed(sequence, choice, seed), CullingErrors(sequence.truth)
        system, _ = load_system(name, feed.intrinsics, chosen.settings if name == "dpl" else [])
        record = run(system, feed, observers=(culling,))
        for line in record.log[:3]:
            print(f"{case} {motion} {seed} {name}: {line}", file=sys.stderr)
        camera, found = score(truth, record)["camera"], culling.metrics()
        people = _people_share(sequence)
        known = "ate" in camera
        yield Row(case, motion, seed, name, 1e3 * camera["ate"]["rmse"] if known else np.nan,
                  1e3 * camera["rpe"]["1f"]["t_rmse"] if known else np.nan, camera["coverage"],
                  found.get("precision", np.nan), found.get("recall", np.nan),
                  float(people.mean()),
                  float(np.mean((people >= COVERED[0]) & (people <= COVERED[1]))))
    renderer.close()


def _people_share(sequence: SimulatedSequence) -> np.ndarray:
    """(K,) of the image."""
    people = [each.instance_id for each in sequence.truth.layout.objects
              if each.name.startswith("person")]
    return np.array([np.isin(sequence.truth.true_instances(k), people).mean()
                     for k in range(len(sequence))])


def _print(row: Row) -> None:
    print(f"| {row.case} | {row.motion} | {row.seed} | {row.system} | {row.ate_mm:.2f} | "
          f"{row.rpe_mm:.2f} | {row.coverage:.2f} | {row.precision:.2f} | {row.recall:.2f} | "
          f"{row.people:.2f} | {row.crowded:.2f} |", flush=True)


def _print_means(rows: Sequence[Row], chosen: argparse.Namespace) -> None:
    print("\n| case | camera | system | ATE mm, mean | RPE 1 frame mm, mean | coverage | "
          "precision | recall |\n|---|---|---|---|---|---|---|---|")
    for case in chosen.cases:
        for motion in (*chosen.motions, "all"):
            for system in chosen.systems:
                mine = [r for r in rows if (r.case, r.system) == (case, system)
                        and motion in (r.motion, "all")]
                if mine:
                    means = [_mean([getattr(r, name) for r in mine]) for name in
                             ("ate_mm", "rpe_mm", "coverage", "precision", "recall")]
                    print(f"| {case} | {motion} | {system} | {means[0]:.2f} | {means[1]:.2f} | "
                          f"{means[2]:.3f} | {means[3]:.2f} | {means[4]:.2f} |")


def _print_ratios(rows: Sequence[Row], chosen: argparse.Namespace) -> None:
    (case, *cases), (system, *systems) = chosen.cases, chosen.systems
    pairs = [((c, s), (c, system)) for c in chosen.cases for s in systems]
    pairs += [((c, s), (case, s)) for c in cases for s in chosen.systems]
    if pairs:
        print("\n| | to | sequences | ATE | RPE 1 frame |\n|---|---|---|---|---|")
    for one, other in pairs:
        a, b = ({(r.motion, r.seed): r for r in rows if (r.case, r.system) == which}
                for which in (one, other))
        both = [(a[key], b[key]) for key in a if key in b]
        if not both:
            continue
        cells = [_ratio([getattr(x, name) / getattr(y, name) for x, y in both])
                 for name in ("ate_mm", "rpe_mm")]
        print(f"| {', '.join(one)} | {', '.join(other)} | {len(both)} | {' | '.join(cells)} |")


def _ratio(ratios: Sequence[float]) -> str:
    """The geometric mean of those that are known, with its 95 % interval."""
    known = [r for r in ratios if np.isfinite(r)]
    if not known:
        return ""
    found = mean_interval(np.log(known))
    mean = f"{np.exp(found.mean):.3f}"
    return mean if found.low is None or found.high is None else \
        f"{mean} [{np.exp(found.low):.3f}, {np.exp(found.high):.3f}]"


def _mean(values: Sequence[float]) -> float:
    known = [v for v in values if np.isfinite(v)]
    return float(np.mean(known)) if known else float("nan")


if __name__ == "__main__":
    main()
