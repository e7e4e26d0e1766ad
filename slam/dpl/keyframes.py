"""Keyframes, what each sees, and who sees the same (covisibility)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from slam.dpl.features import Features, no_lines, no_points
from slam.dpl.landmarks import Landmarks
from slam.dpl.observers import Observers
from slam.geometry import se3
from slam.geometry.arrays import Array


@dataclass(slots=True)
class Keyframe:
    number: int
    frame: int               # row in the run
    T_world_camera: Array    # (4, 4)
    features: Features
    point_of: Array          # (N,) int64 row of the map point each key point is, −1: none
    line_of: Array           # (L,) the same of map lines; both written by the map alone
    part: int = 0            # of the map: 1 and on begin where tracking had been lost
    alive: bool = True
    parent: int = -1         # of a dead keyframe: the one it hangs on
    T_parent: Array = field(default_factory=lambda: np.eye(4))   # T_parent_camera, then


class PointLineMap:
    """Keyframes with map points and lines, and who sees which."""

    def __init__(self) -> None:
        self.points, self.lines = Landmarks(1), Landmarks(2)
        self.keyframes: list[Keyframe] = []
        self.part = -1           # the one that grows
        self.point_observers, self.line_observers = Observers(), Observers()

    def begin_part(self) -> None:
        """What comes is not tied to what was: tracking had been lost."""
        self.part += 1

    def add_keyframe(self, frame: int, T_world_camera: Array, features: Features,
                     point_of: Array, line_of: Array) -> Keyframe:
        nothing = np.full(len(point_of), -1), np.full(len(line_of), -1)
        keyframe = Keyframe(len(self.keyframes), frame, np.array(T_world_camera), features,
                            *nothing, self.part)
        self.keyframes.append(keyframe)
        self.see_points(keyframe, point_of)
        self.see_lines(keyframe, line_of)
        return keyframe

    def see_points(self, keyframe: Keyframe, point_of: Array) -> None:
        """From now on the keyframe's points are these landmarks (N,), −1: none."""
        _change(self.point_observers, keyframe.number, keyframe.point_of, point_of)
        keyframe.point_of = np.array(point_of)

    def see_lines(self, keyframe: Keyframe, line_of: Array) -> None:
        """From now on the keyframe's lines are these landmarks (L,), −1: none."""
        _change(self.line_observers, keyframe.number, keyframe.line_of, line_of)
        keyframe.line_of = np.array(line_of)

    def drop_keyframe(self, keyframe: Keyframe) -> None:
        """A keyframe dies; it stays where it is as seen from the one that shares most with it.

        Where none shares anything with it, that is the living one next to it in time. Of what it
        saw nothing is kept.

        Raises:
            ValueError: no other keyframe is alive.
        """
        near = self.neighbours(keyframe, 1, at_least=1) or sorted(
            (k for k in self.living() if k is not keyframe),
            key=lambda k: abs(k.number - keyframe.number))
        if not near:
            raise ValueError("the last living keyframe of a map cannot be dropped")
        keyframe.alive, keyframe.parent = False, near[0].number
        keyframe.T_parent = se3.inverse(near[0].T_world_camera) @ keyframe.T_world_camera
        keyframe.features = Features(no_points(), no_lines())
        self.see_points(keyframe, np.zeros(0, np.int64))
        self.see_lines(keyframe, np.zeros(0, np.int64))

    def holder(self, number: int) -> tuple[Keyframe, Array]:
        """The living keyframe that a keyframe is or hangs on, and T_holder_keyframe (4, 4)."""
        keyframe, T = self.keyframes[number], np.eye(4)
        while not keyframe.alive:
            T = keyframe.T_parent @ T
            keyframe = self.keyframes[keyframe.parent]
        return keyframe, T

    def pose(self, number: int) -> Array:
        """T_world_camera (4, 4) of a keyframe, dead ones where their parents have taken them."""
        keyframe, T = self.holder(number)
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

    def newest(self) -> Keyframe:
        """The living keyframe that was added last."""
        return next(k for k in reversed(self.keyframes) if k.alive)

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
        observers, see, name = ((self.point_observers, self.see_points, "point_of")
                                if table is self.points else
                                (self.line_observers, self.see_lines, "line_of"))
        for number in np.unique(observers.of(gone)):
            keyframe = self.keyframes[number]
            see(keyframe, _each_once(new[getattr(keyframe, name)]))

    def forget_landmarks(self, point_rows: Array, line_rows: Array) -> None:
        """These landmarks are gone: nobody sees them, and their rows may be had by new ones."""
        gone_points = np.zeros(self.points.count + 1, bool)      # the last row answers −1
        gone_lines = np.zeros(self.lines.count + 1, bool)
        gone_points[point_rows], gone_lines[line_rows] = True, True
        for number in np.unique(self.point_observers.of(point_rows)):
            of = self.keyframes[number].point_of
            self.see_points(self.keyframes[number], np.where(gone_points[of], -1, of))
        for number in np.unique(self.line_observers.of(line_rows)):
            of = self.keyframes[number].line_of
            self.see_lines(self.keyframes[number], np.where(gone_lines[of], -1, of))
        self.points.remove(point_rows)
        self.lines.remove(line_rows)

    def covisible(self, point_rows: Array, line_rows: Array) -> Array:
        """(K,) how many of these landmarks, each named once, each keyframe sees."""
        seeing = np.concatenate([self.point_observers.of(point_rows),
                                 self.line_observers.of(line_rows)])
        return np.bincount(seeing, minlength=len(self.keyframes))

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


def _change(observers: Observers, keyframe: int, before: Array, after: Array) -> None:
    """Tell the observers what a keyframe sees after, that saw `before`: each landmark once."""
    if len(before) == len(after):
        changed = before != after                 # few are
        before, after = before[changed], after[changed]
    observers.remove(before[before >= 0], keyframe)
    observers.add(after[after >= 0], keyframe)


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
