"""Tables of landmarks: struct of arrays, a row for the life of a landmark, then for another's."""

from __future__ import annotations

import numpy as np

from slam.dpl.matching import as_words
from slam.geometry.arrays import Array


class Landmarks:
    """Map points (k = 1 position each) or map lines (k = 2 ends each), metres, in the world."""

    def __init__(self, positions: int) -> None:
        self._positions = positions
        self.count = 0
        self._free = np.zeros(0, np.int64)           # rows whose landmarks are gone
        self._made = 0                               # landmarks so far
        self._make(1024)

    def _make(self, size: int) -> None:
        self._xyz = np.zeros((size, self._positions, 3))
        self._words = np.zeros((size, 4), np.uint64)
        self._level = np.zeros(size, np.int32)       # at which it was first seen
        self._distance = np.ones(size)               # m from the camera, there
        self._normal = np.zeros((size, 3))           # unit, from the landmark to that camera
        self._alive = np.zeros(size, bool)
        self._identity = np.zeros(size, np.int64)    # never another landmark's, as a row may be
        self._born = np.zeros(size, np.int64)        # number of the keyframe that made it
        self._reference = np.zeros(size, np.int64)   # number of the keyframe it follows (eq. 1)
        self._found = np.ones(size, np.int64)        # frames that used it
        self._visible = np.ones(size, np.int64)      # frames that should have seen it

    # The rows in use, as views.
    xyz = property(lambda self: self._xyz[:self.count])
    words = property(lambda self: self._words[:self.count])
    level = property(lambda self: self._level[:self.count])
    distance = property(lambda self: self._distance[:self.count])
    normal = property(lambda self: self._normal[:self.count])
    alive = property(lambda self: self._alive[:self.count])
    identity = property(lambda self: self._identity[:self.count])
    born = property(lambda self: self._born[:self.count])
    reference = property(lambda self: self._reference[:self.count])
    found = property(lambda self: self._found[:self.count])
    visible = property(lambda self: self._visible[:self.count])

    def add(self, xyz: Array, descriptor: Array, level: Array, camera_centre: Array,
            keyframe: int) -> Array:
        """New landmarks (N, k, 3), seen from a camera at `camera_centre` (3,); their rows (N,)."""
        reused = min(len(self._free), len(xyz))
        rows = np.concatenate([self._free[:reused],
                               np.arange(self.count, self.count + len(xyz) - reused)])
        self._free = self._free[reused:]
        self._grow(len(xyz) - reused)
        self._xyz[rows], self._words[rows], self._level[rows] = xyz, as_words(descriptor), level
        away = camera_centre - xyz.mean(axis=1)
        length = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        self._distance[rows], self._normal[rows] = length, away / length[:, None]
        self._alive[rows] = True
        self._identity[rows] = self._made + np.arange(len(rows))
        self._made += len(rows)
        self._born[rows] = self._reference[rows] = keyframe
        self._found[rows] = self._visible[rows] = 1
        return rows

    def level_at(self, rows: Array, distance_m: Array, scale: float) -> Array:
        """(N,) at which level of a pyramid landmarks look as they did, seen from distances (N,)."""
        nearer = self.distance[rows] / distance_m
        return np.asarray(self.level[rows] + np.log(nearer) / np.log(scale))

    def count_use(self, in_view: Array, used: Array) -> None:
        """A frame should have seen the landmarks `in_view` (N,), and its pose used these (M,)."""
        self._visible[in_view] += 1
        self._found[used] += 1

    def remove(self, rows: Array) -> None:
        """Landmarks (N,) that nothing refers to any more; their rows may be had by new ones."""
        self._alive[rows] = False
        self._free = np.flatnonzero(~self.alive)

    def _grow(self, more: int) -> None:
        size = len(self._alive)
        if self.count + more > size:
            held = {name: value for name, value in vars(self).items()
                    if isinstance(value, np.ndarray) and name != "_free"}
            self._make(max(2 * size, self.count + more))
            for name, value in held.items():
                getattr(self, name)[:size] = value
        self.count += more
