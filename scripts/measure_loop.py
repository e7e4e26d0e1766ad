"""What closing loops brings: trajectory and map lines with it and without it, and false loops.

    simbench generate Loop-v0 --stereo --size 608x184 --frames 345 --seed 1 --out loop1
    python scripts/measure_loop.py loop1 [MORE FOLDERS] [--system dpl] [--depth stereo]

A loop is false if the pose it claims is off by more than 0.5 m or 5°. Lines are compared with the
true static edges of the scene, as the trajectories' alignment places them: the mean distance of
their middles from the nearest true edge, of those within 1 m (the others are drawn, not built).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import simbench
from simbench.inputs import Feed, InputChoice
from simbench.metrics.loops import loop_metrics
from simbench.metrics.trajectory import ate_errors, rigid_alignment
from simbench.score import truncated
from simbench.sequence import SequenceTruth
from slam.dpl.config import DplConfig
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.systems.dpl import DplSlam
from slam.systems.registry import default_config

_NEAR_M = 1.0
_AT_ONCE = 200           # lines


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+")
    parser.add_argument("--system", default="dpl", choices=("dpl", "orb", "orb-lines"))
    parser.add_argument("--depth", default=None)
    parser.add_argument("--frames", type=int, default=None)
    given = parser.parse_args(arguments)
    print("| sequence | loops, false | ATE m: without | with | ratio | lines to edges m: without | "
          "with |\n|---|---|---|---|---|---|---|")
    for folder in given.folders:
        sequence = simbench.open_sequence(folder)
        feed = Feed(sequence, InputChoice(flow="dis", masks="none", boxes="none",
                                          depth=given.depth), 0, given.frames)
        config = default_config(given.system)
        assert isinstance(config, DplConfig)
        systems = [DplSlam(feed.intrinsics, replace(config, loop=replace(
            config.loop, enabled=enabled))) for enabled in (False, True)]
        for k in range(len(feed)):
            frame = feed.frame(k)
            for system in systems:
                system.process(frame)
        assert sequence.truth is not None
        print(row(folder, systems, sequence.truth, len(feed)), flush=True)


def row(name: str, systems: list[DplSlam], truth: SequenceTruth, frames: int) -> str:
    """One line of the table."""
    true = truth.trajectories.T_world_camera[:frames]
    edges = None if truth.layout is None else static_edges(truth)
    ate, lines = [], []
    for system in systems:
        result = system.finish()
        ate.append(float(np.sqrt(np.mean(ate_errors(result.T_world_camera, true) ** 2))))
        placed = rigid_alignment(result.T_world_camera[:, :3, 3], true[:, :3, 3])
        lines.append(np.nan if edges is None or result.lines_world is None else edge_distance(
            se3.transform_points(placed, result.lines_world.mean(axis=1)), edges))
    loops = loop_metrics(result, truth.trajectories.stamps_s[:frames],
                         truncated(truth.trajectories, frames))
    return (f"| {name} | {loops['closed']}, {loops['false']} | {ate[0]:.4f} | {ate[1]:.4f} | "
            f"{ate[1] / ate[0]:.2f} | {lines[0]:.4f} | {lines[1]:.4f} |")


def static_edges(truth: SequenceTruth) -> Array:
    """(E, 2, 3) true edges of what belongs to no object, in the world, m."""
    assert truth.layout is not None
    edges = truth.layout.edges
    still = truth.layout.instance_of_part[edges.part_id] == 0
    T = truth.frame(0).T_world_part[edges.part_id[still]]
    return np.asarray(se3.transform_points(T, edges.endpoints_part[still]))


def edge_distance(middles: Array, edges: Array) -> float:
    """Mean distance of points (N, 3) from the nearest of the edges, of those within 1 m."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-12)
    nearest = []
    for first in range(0, len(middles), _AT_ONCE):
        gap = middles[first:first + _AT_ONCE, None] - start
        t = np.clip(np.sum(gap * along, axis=2) / length2, 0.0, 1.0)
        nearest.append(np.linalg.norm(gap - t[:, :, None] * along, axis=2).min(axis=1))
    distance = np.concatenate(nearest) if nearest else np.zeros(0)
    near = distance[distance < _NEAR_M]
    return float(near.mean()) if len(near) else float("nan")


if __name__ == "__main__":
    main()
