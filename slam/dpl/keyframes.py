"""Keyframes, what each sees, and who sees the same (covisibility)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slam.dpl.features import Features
from slam.dpl.landmarks import Landmarks
from slam.geometry.arrays import Array


@dataclass(slots=True)
class Keyframe:
    number: int
    frame: int               # row in the run
    T_world_camera: Array    # (4, 4)
    features: Features
    point_of: Array          # (N,) int64 row of the map point each key point is, −1: none
    line_of: Array           # (L,) the same of map lines
    alive: bool = True


@dataclass(slots=True)
class PointLineMap:
    """Keyframes with map points and lines."""

    points: Landmarks = field(default_factory=lambda: Landmarks(1))
    lines: Landmarks = field(default_factory=lambda: Landmarks(2))
    keyframes: list[Keyframe] = field(default_factory=list)

    def add_keyframe(self, frame: int, T_world_camera: Array, features: Features,
                     point_of: Array, line_of: Array) -> Keyframe:
        keyframe = Keyframe(len(self.keyframes), frame, np.array(T_world_camera), features,
                            np.array(point_of), np.array(line_of))
        self.keyframes.append(keyframe)
        return keyframe

    def forget_dead(self, keyframe: Keyframe) -> None:
        """Drop a keyframe's sightings of landmarks that are gone."""
        for of, table in ((keyframe.point_of, self.points), (keyframe.line_of, self.lines)):
            held = of >= 0
            of[held] = np.where(table.alive[of[held]], of[held], -1)

    def covisible(self, point_rows: Array, line_rows: Array) -> Array:
        """(K,) how many of these landmarks each keyframe sees; dead keyframes see none."""
        is_point = np.zeros(self.points.count + 1, bool)     # the last row answers −1
        is_line = np.zeros(self.lines.count + 1, bool)
        is_point[point_rows], is_line[line_rows] = True, True
        return np.array([np.count_nonzero(is_point[k.point_of]) + np.count_nonzero(
            is_line[k.line_of]) if k.alive else 0 for k in self.keyframes], dtype=np.int64)

    def neighbours(self, keyframe: Keyframe, count: int, at_least: int = 15) -> list[Keyframe]:
        """The other keyframes that see most of what this one sees, best first."""
        shared = self.covisible(keyframe.point_of[keyframe.point_of >= 0],
                                keyframe.line_of[keyframe.line_of >= 0])
        shared[keyframe.number] = 0
        best = np.argsort(-shared, kind="stable")[:count]
        return [self.keyframes[i] for i in best if shared[i] >= at_least]

    def well_seen(self, keyframe: Keyframe, times: int) -> int:
        """How many landmarks of a keyframe at least so many keyframes see."""
        total = 0
        for name, table in (("point_of", self.points), ("line_of", self.lines)):
            count = np.zeros(table.count + 1, np.int64)
            for other in self.keyframes:
                if other.alive:
                    count[getattr(other, name)] += 1     # each landmark once a keyframe
            count[-1] = 0                                # the last row answers −1
            total += int(np.count_nonzero(count[getattr(keyframe, name)] >= times))
        return total

    def landmarks_of(self, keyframes: list[Keyframe]) -> tuple[Array, Array]:
        """Rows of the living points and lines that any of these keyframes sees, ascending."""
        points = unique_rows([k.point_of for k in keyframes])
        lines = unique_rows([k.line_of for k in keyframes])
        return points[self.points.alive[points]], lines[self.lines.alive[lines]]


def unique_rows(parts: list[Array]) -> Array:
    """The rows ≥ 0 of all parts, each once, ascending."""
    rows = np.unique(np.concatenate(parts)) if parts else np.zeros(0, np.int64)
    return rows[rows >= 0]
