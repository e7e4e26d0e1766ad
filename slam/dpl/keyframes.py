"""Keyframes, what each sees, and who sees the same (covisibility)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from slam.dpl.features import Features, no_lines, no_points
from slam.dpl.landmarks import Landmarks
from slam.geometry import se3
from slam.geometry.arrays import Array


@dataclass(slots=True)
class Keyframe:
    number: int
    frame: int               # row in the run
    T_world_camera: Array    # (4, 4)
    features: Features
    point_of: Array          # (N,) int64 row of the map point each key point is, −1: none
    line_of: Array           # (L,) the same of map lines
    part: int = 0            # of the map: 1 and on begin where tracking had been lost
    alive: bool = True
    parent: int = -1         # of a dead keyframe: the one it hangs on
    T_parent: Array = field(default_factory=lambda: np.eye(4))   # T_parent_camera, then


@dataclass(slots=True)
class PointLineMap:
    """Keyframes with map points and lines."""

    points: Landmarks = field(default_factory=lambda: Landmarks(1))
    lines: Landmarks = field(default_factory=lambda: Landmarks(2))
    keyframes: list[Keyframe] = field(default_factory=list)
    part: int = -1           # the one that grows

    def begin_part(self) -> None:
        """What comes is not tied to what was: tracking had been lost."""
        self.part += 1

    def add_keyframe(self, frame: int, T_world_camera: Array, features: Features,
                     point_of: Array, line_of: Array) -> Keyframe:
        keyframe = Keyframe(len(self.keyframes), frame, np.array(T_world_camera), features,
                            np.array(point_of), np.array(line_of), self.part)
        self.keyframes.append(keyframe)
        return keyframe

    def drop_keyframe(self, keyframe: Keyframe) -> None:
        """A keyframe dies; it stays where it is as seen from the one that shares most with it.

        Of what it saw nothing is kept.
        """
        near = self.neighbours(keyframe, 1, at_least=1)
        parent = near[0] if near else self.keyframes[keyframe.number - 1]
        keyframe.alive, keyframe.parent = False, parent.number
        keyframe.T_parent = se3.inverse(self.pose(parent.number)) @ keyframe.T_world_camera
        keyframe.features = Features(no_points(), no_lines())
        keyframe.point_of = keyframe.line_of = np.zeros(0, np.int64)

    def pose(self, number: int) -> Array:
        """T_world_camera (4, 4) of a keyframe, dead ones where their parents have taken them."""
        keyframe, T = self.keyframes[number], np.eye(4)
        while not keyframe.alive:
            T = keyframe.T_parent @ T
            keyframe = self.keyframes[keyframe.parent]
        return keyframe.T_world_camera @ T

    def poses(self) -> Array:
        """(K, 4, 4) of all keyframes, by number."""
        return np.array([k.T_world_camera if k.alive else self.pose(k.number)
                         for k in self.keyframes]).reshape(-1, 4, 4)

    def poses_of(self, numbers: Array) -> Array:
        """(N, 4, 4) of some keyframes, each sought once however often it is named."""
        each, which = np.unique(numbers, return_inverse=True)
        return np.array([self.pose(number) for number in each]).reshape(-1, 4, 4)[which]

    def living(self) -> list[Keyframe]:
        return [k for k in self.keyframes if k.alive]

    def follow_references(self, before: Array, after: Array, point_rows: Array,
                          line_rows: Array) -> None:
        """Landmarks go where their reference keyframes went (DPL-SLAM eq. 1).

        Args:
            before, after: (K, 4, 4) poses of all keyframes, T_world_camera.
        """
        moved = after @ se3.inverse(before)
        for table, rows in ((self.points, point_rows), (self.lines, line_rows)):
            T = moved[table.reference[rows]]
            table.xyz[rows] = se3.transform_points(T, table.xyz[rows])

    def merge(self, table: Landmarks, a: Array, b: Array) -> None:
        """Landmarks a (N,) of a table turn out to be b (N,): the oldest of each stays."""
        if not len(a):
            return
        same = csr_array((np.ones(len(a)), (a, b)), shape=(table.count, table.count))
        group = connected_components(same, directed=False)[1]
        by_age = np.argsort(table.born, kind="stable")
        oldest = by_age[np.unique(group[by_age], return_index=True)[1]][group]
        gone = np.flatnonzero(oldest != np.arange(table.count))
        table.alive[gone] = False
        np.add.at(table.found, oldest[gone], table.found[gone])
        np.add.at(table.visible, oldest[gone], table.visible[gone])
        new = np.append(oldest, -1)               # the last row answers −1
        name = "point_of" if table is self.points else "line_of"
        for keyframe in self.keyframes:
            setattr(keyframe, name, _each_once(new[getattr(keyframe, name)]))

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

    def landmarks_of(self, keyframes: list[Keyframe]) -> tuple[Array, Array]:
        """Rows of the living points and lines that any of these keyframes sees, ascending."""
        points = unique_rows([k.point_of for k in keyframes])
        lines = unique_rows([k.line_of for k in keyframes])
        return points[self.points.alive[points]], lines[self.lines.alive[lines]]


def shared_landmarks(map_: PointLineMap, keyframes: list[Keyframe]) -> Array:
    """(A, A) how many landmarks keyframes have in common."""
    width = map_.points.count + map_.lines.count
    rows, columns = [], []
    for i, k in enumerate(keyframes):
        held = np.concatenate([k.point_of[k.point_of >= 0],
                               map_.points.count + k.line_of[k.line_of >= 0]])
        rows.append(np.full(len(held), i))
        columns.append(held)
    at = np.concatenate(rows), np.concatenate(columns)
    sees = csr_array((np.ones(len(at[0]), np.int32), at), shape=(len(keyframes), width))
    return np.asarray((sees @ sees.T).toarray())


def _each_once(of: Array) -> Array:
    """The same with a landmark's second and later features left without one."""
    seen, first = np.unique(of, return_index=True)
    out = np.full_like(of, -1)
    first = first[seen >= 0]
    out[first] = of[first]
    return out


def unique_rows(parts: list[Array]) -> Array:
    """The rows ≥ 0 of all parts, each once, ascending."""
    rows = np.unique(np.concatenate(parts)) if parts else np.zeros(0, np.int64)
    return rows[rows >= 0]
