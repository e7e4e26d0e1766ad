"""Loops that are closed where there are none: many seeds of scenes in which no place comes again.

    python scripts/measure_false_loops.py [--seeds 20] [--scenes Street-v0 ...] [--system dpl]
        [--set loop.consistent=1]

Each run is short and small, in memory, with the depth of a Kinect (in the streets of a Gaussian
sensor) and true boxes. A loop is false if the pose it claims is off by more than 0.5 m or 5°; a
true one is of the place where the camera still is. `proposed` counts the keyframes that words
took for the same place and geometry had to refuse or accept.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from simbench.inputs import Feed, InputChoice
from simbench.load_system import load_system
from simbench.metrics.loops import loop_metrics
from simbench.render import make_renderer
from simbench.score import truncated
from simbench.simulate import SimulatedSequence
from simbench.world import make_world
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.systems.dpl import DplSlam
from slam.types import Status


@dataclass(frozen=True, slots=True)
class Case:
    size: tuple[int, int]
    frames: int
    fps: float
    sensor: str


CASES = {"SwingingBoxes-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Office-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Corridor-v0": Case((320, 240), 60, 10.0, "kinect"),
         "Street-v0": Case((608, 184), 100, 10.0, "gaussian")}


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


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenes", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--system", default="dpl", choices=("dpl", "orb", "orb-lines"))
    parser.add_argument("--set", dest="settings", action="append", default=[],
                        metavar="STAGE.FIELD=VALUE")
    chosen = parser.parse_args(words)
    print("| scene | runs | frames, lost | keyframes | proposed | closed | false |\n"
          "|---|---|---|---|---|---|---|", flush=True)
    for scene in chosen.scenes:
        total = Total()
        for seed in range(chosen.seeds):
            _add(total, scene, seed, chosen.system, chosen.settings)
        print(f"| {scene} | {total.runs} | {total.frames}, {total.lost} | {total.keyframes} | "
              f"{total.proposed} | {total.closed} | {total.false} |", flush=True)


def _add(total: Total, scene: str, seed: int, name: str, settings: Iterable[str]) -> None:
    case = CASES[scene]
    world = make_world(scene, seed, {}, case.size, case.fps)
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, case.frames)
    feed = Feed(sequence, InputChoice(flow="dis", masks="none", boxes="truth",
                                      sensor=case.sensor), seed)
    system, _ = load_system(name, feed.intrinsics, list(settings))
    assert isinstance(system, DplSlam)
    _count_proposals(system, total)
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


def _count_proposals(system: DplSlam, total: Total) -> None:
    candidates = system.loop_detector.candidates

    def counted(map_: PointLineMap, keyframe: Keyframe) -> list[Keyframe]:
        found = candidates(map_, keyframe)
        total.proposed += len(found)
        return found

    system.loop_detector.candidates = counted  # type: ignore[method-assign]


if __name__ == "__main__":
    main()
