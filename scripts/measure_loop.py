"""What closing loops brings: trajectory and map lines with it and without it, and false loops.

    simbench generate Loop-v0 --stereo --size 608x184 --frames 345 --seed 1 --out loop1
    python scripts/measure_loop.py loop1 [MORE FOLDERS] [--system dpl] [--depth stereo]

Of stereo pairs the systems match points and lines themselves, as in `simbench run`. A loop is false
if the pose it claims is off by more than 0.5 m or 5°. Map lines are compared with the true static
edges of the scene, as the trajectories' alignment places them. Many lines are drawn on walls and
roads, not built; so those lines count that are edges: that lie within 0.2 m of one where their
reference keyframe, at its true pose, puts them. Their mean distance from the nearest edge is what a
map bent by drift, or lines that do not follow their keyframes, would enlarge; `at best` is what it
is with true keyframes.
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

_NEAR_M = 0.2
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
          "with | at best |\n|---|---|---|---|---|---|---|---|")
    for folder in given.folders:
        sequence = simbench.open_sequence(folder)
        feed = Feed(sequence, InputChoice(flow="dis", masks="none", boxes="none",
                                          depth=given.depth), 0, given.frames)
        config = default_config(given.system)
        assert isinstance(config, DplConfig)
        systems = [DplSlam(feed.intrinsics, replace(config, loop=replace(
            config.loop, enabled=enabled))) for enabled in (False, True)]
        feed.leave_stereo_to(systems[0])
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
        lines.append((np.nan, np.nan) if edges is None
                     else edge_errors(system, placed, true, edges))
    loops = loop_metrics(result, truth.trajectories.stamps_s[:frames],
                         truncated(truth.trajectories, frames))
    return (f"| {name} | {loops['closed']}, {loops['false']} | {ate[0]:.4f} | {ate[1]:.4f} | "
            f"{ate[1] / ate[0]:.2f} | {lines[0][0]:.4f} | {lines[1][0]:.4f} | {lines[1][1]:.4f} |")


def edge_errors(system: DplSlam, T_true_world: Array, T_true: Array, edges: Array
                ) -> tuple[float, float]:
    """Mean distance of map lines that are edges from the edges, and with true keyframes."""
    table = system.map.lines
    rows = np.flatnonzero(table.alive)
    middles, holder = table.xyz[rows].mean(axis=1), table.reference[rows]
    frame = np.array([k.frame for k in system.map.keyframes])[holder]
    T = T_true[frame] @ se3.inverse(system.map.poses()[holder])
    best = edge_distances(se3.transform_points(T, middles[:, None])[:, 0], edges)
    found = edge_distances(se3.transform_points(T_true_world, middles), edges)
    near = best < _NEAR_M
    return float(found[near].mean()), float(best[near].mean())


def static_edges(truth: SequenceTruth) -> Array:
    """(E, 2, 3) true edges of what belongs to no object, in the world, m."""
    assert truth.layout is not None
    edges = truth.layout.edges
    still = truth.layout.instance_of_part[edges.part_id] == 0
    T = truth.frame(0).T_world_part[edges.part_id[still]]
    return np.asarray(se3.transform_points(T, edges.endpoints_part[still]))


def edge_distances(middles: Array, edges: Array) -> Array:
    """(N,) distance of each point (N, 3) from the nearest of the edges."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-12)
    nearest = [np.zeros(0)]
    for first in range(0, len(middles), _AT_ONCE):
        gap = middles[first:first + _AT_ONCE, None] - start
        t = np.clip(np.sum(gap * along, axis=2) / length2, 0.0, 1.0)
        nearest.append(np.linalg.norm(gap - t[:, :, None] * along, axis=2).min(axis=1))
    return np.concatenate(nearest)


if __name__ == "__main__":
    main()
