"""Loops that are closed, and where there are none: many seeds of scenes, most without a way back.

    python scripts/measure_false_loops.py [--seeds 20] [--scenes Loop-v0 ...] [--system dpl]
        [--set loop.consistent=1]

Each run is short and small, in memory, with true boxes, and with the depth of a Kinect; in the
streets of a Gaussian sensor; on Loop-v0, which is driven round at twice the pace and some way on,
of the pairs that the system matches itself. A loop is false if the pose it claims is off by more
than 0.5 m or 5°; a true one is of a place where the camera was. `proposed` counts the keyframes
that words took for the same place and geometry had to refuse or accept. ATE is that of the run so
far just before the first loop of each run is closed, and just after.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from simbench.inputs import Feed, InputChoice
from simbench.load_system import load_system
from simbench.metrics.loops import loop_metrics
from simbench.metrics.trajectory import ate_errors
from simbench.render import make_renderer
from simbench.score import truncated
from simbench.simulate import SimulatedSequence
from simbench.statistics import mean_interval
from simbench.world import make_world
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.loop_verify import Loop
from slam.geometry.arrays import Array
from slam.systems.dpl import DplSlam
from slam.types import Status


@dataclass(frozen=True, slots=True)
class Case:
    size: tuple[int, int]
    frames: int
    fps: float
    sensor: str | None       # None: depth from stereo
    dials: dict[str, float] = field(default_factory=dict)


CASES = {"SwingingBoxes-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Office-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Corridor-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Street-v0": Case((608, 184), 100, 10.0, "gaussian"),
         "Loop-v0": Case((608, 184), 175, 10.0, None, {"camera_speed": 2.0})}


@dataclass(slots=True)
class Total:
    """Over the seeds of a scene."""

    runs: int = 0
    frames: int = 0
    lost: int = 0
    keyframes: int = 0
    proposed: int = 0
    closed: int = 0
    false: int = 0
    ate_m: list[tuple[float, float]] = field(default_factory=list)   # before and after, by run


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenes", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--system", default="dpl", choices=("dpl", "orb", "orb-lines"))
    parser.add_argument("--set", dest="settings", action="append", default=[],
                        metavar="STAGE.FIELD=VALUE")
    chosen = parser.parse_args(words)
    print("| scene | runs | frames, lost | keyframes | proposed | closed | false | ATE m: before | "
          "after | ratio |\n|---|---|---|---|---|---|---|---|---|---|", flush=True)
    for scene in chosen.scenes:
        total = Total()
        for seed in range(chosen.seeds):
            _add(total, scene, seed, chosen.system, chosen.settings)
            print(f"  {scene} seed {seed}: {total}", file=sys.stderr, flush=True)
        print(f"| {scene} | {total.runs} | {total.frames}, {total.lost} | {total.keyframes} | "
              f"{total.proposed} | {total.closed} | {total.false} | {_gain(total)} |", flush=True)


def _gain(total: Total) -> str:
    """Means over the runs, with 95 % intervals, and the geometric mean of their ratios."""
    if not total.ate_m:
        return " | | "
    ate = np.array(total.ate_m)
    ratio = mean_interval(np.log(ate[:, 1] / ate[:, 0]))
    means = [mean_interval(ate[:, i]) for i in (0, 1)]
    cells = [(m.mean, m.low, m.high) for m in means]
    cells.append(tuple(None if x is None else float(np.exp(x))
                       for x in (ratio.mean, ratio.low, ratio.high)))
    return " | ".join(f"{mean:.4f}" if low is None else f"{mean:.4f} ({low:.4f} to {high:.4f})"
                      for mean, low, high in cells)


def _add(total: Total, scene: str, seed: int, name: str, settings: Iterable[str]) -> None:
    case = CASES[scene]
    stereo = case.sensor is None
    world = make_world(scene, seed, case.dials, case.size, case.fps)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, case.frames, stereo=stereo)
    feed = Feed(sequence, InputChoice(flow="dis", masks="none", boxes="truth", sensor=case.sensor,
                                      depth="stereo" if stereo else None), seed)
    system, _ = load_system(name, feed.intrinsics, list(settings))
    assert isinstance(system, DplSlam)
    feed.leave_stereo_to(system)
    _count_proposals(system, total)
    first = _first_closing(system, sequence.truth.trajectories.T_world_camera)
    for k in range(case.frames):
        total.lost += system.process(feed.frame(k)).status is Status.LOST
    found = loop_metrics(system.finish(), sequence.stamps_s,
                         truncated(sequence.truth.trajectories, case.frames))
    renderer.close()
    total.runs += 1
    total.frames += case.frames
    total.keyframes += len(system.map.keyframes)
    total.closed += found["closed"]
    total.false += found["false"]
    total.ate_m += first


def _first_closing(system: DplSlam, T_true: Array) -> list[tuple[float, float]]:
    """A list that will hold the ATE before and after the first loop that the system closes."""
    close, first = system.loop_closer.close, list[tuple[float, float]]()

    def error_m() -> float:
        T = system.history.result().T_world_camera
        return float(np.sqrt(np.mean(ate_errors(T, T_true[:len(T)]) ** 2)))

    def measured(map_: PointLineMap, loop: Loop) -> bool:
        before = error_m()
        closed = close(map_, loop)
        if closed and not first:
            first.append((before, error_m()))
        return closed

    system.loop_closer.close = measured  # type: ignore[method-assign]
    return first


def _count_proposals(system: DplSlam, total: Total) -> None:
    candidates = system.loop_detector.candidates

    def counted(map_: PointLineMap, keyframe: Keyframe) -> list[Keyframe]:
        found = candidates(map_, keyframe)
        total.proposed += len(found)
        return found

    system.loop_detector.candidates = counted  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
