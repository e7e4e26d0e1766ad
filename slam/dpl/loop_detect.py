"""Which keyframes from before may show the place of this one: likeness, groups, consistency."""

from __future__ import annotations

import numpy as np

from slam.dpl.config import LoopConfig
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.recognise import PlaceIndex

_GROUP = 10              # covisible keyframes that count as one place
_LOOKED_AT = 10          # keyframes most like the new one
_PLACES = 3              # that a keyframe proposes at most


class LoopDetector:
    """Proposes keyframes; remembers what the last keyframes proposed (ORB-SLAM's scheme)."""

    def __init__(self, index: PlaceIndex, config: LoopConfig) -> None:
        self.index, self.config = index, config
        self._before: list[tuple[set[int], int]] = []     # place, for how many keyframes in a row
        self._resting = 0                                 # keyframes to let pass

    def candidates(self, map_: PointLineMap, keyframe: Keyframe) -> list[Keyframe]:
        """Keyframes whose place was proposed by enough keyframes in a row, best first."""
        if self._resting > 0:
            self._resting -= 1
            return []
        now: list[tuple[set[int], int]] = []
        out = []
        for best, place in self._places(map_, keyframe):
            row = 1 + max((n for other, n in self._before if other & place), default=0)
            now.append((place, row))
            if row >= self.config.consistent:
                out.append(map_.keyframes[best])
        self._before = now
        return out

    def rest(self) -> None:
        """A loop was closed: for some keyframes no other is looked for."""
        self._before, self._resting = [], self.config.rest

    def _places(self, map_: PointLineMap, keyframe: Keyframe) -> list[tuple[int, set[int]]]:
        """The best keyframe of each likely place and the place, best first."""
        scores = self.index.scores(self.index.bags[keyframe.number])
        shared = map_.covisible(keyframe.point_of[keyframe.point_of >= 0],
                                keyframe.line_of[keyframe.line_of >= 0])
        near = shared >= self.config.near_landmarks
        near[keyframe.number] = False
        if not near.any():
            return []                             # nothing to tell what likeness a place has
        alive = np.array([k.alive for k in map_.keyframes])
        likely = alive & (shared == 0) & (scores >= self.config.likeness * scores[near].min())
        likely[keyframe.number] = False
        order = np.argsort(-scores, kind="stable")
        found: dict[int, tuple[float, set[int]]] = {}
        for number in order[likely[order]][:_LOOKED_AT].tolist():
            group = [k.number for k in map_.neighbours(map_.keyframes[number], _GROUP)]
            group.append(number)
            members = [n for n in group if likely[n]]
            best = max(members, key=lambda n: (scores[n], -n))
            total = float(scores[members].sum())
            if best not in found or total > found[best][0]:
                found[best] = (total, set(group))
        best_first = sorted(found, key=lambda n: (-found[n][0], n))
        return [(n, found[n][1]) for n in best_first[:_PLACES]]
