"""Place recognition: which keyframes look like an image, by the words that both hold."""

from __future__ import annotations

import numpy as np

from slam.dpl.vocabulary import Bag, Vocabulary, shipped
from slam.geometry.arrays import Array


class PlaceIndex:
    """The bags of all keyframes, by their numbers."""

    def __init__(self, vocabulary: Vocabulary | None = None) -> None:
        self.vocabulary = shipped() if vocabulary is None else vocabulary
        self.bags: list[Bag] = []
        self._held = 0                            # entries in use of these three
        self._keyframe = np.zeros(4096, np.int64)
        self._word = np.zeros(4096, np.int64)
        self._weight = np.zeros(4096)

    def add(self, descriptor: Array) -> None:
        """The next keyframe, by its descriptors (N, 32) uint8."""
        bag = self.vocabulary.bag(descriptor)
        entries = slice(self._held, self._held + len(bag.word))
        while entries.stop > len(self._word):
            self._keyframe, self._word, self._weight = (
                np.concatenate([a, np.zeros_like(a)])
                for a in (self._keyframe, self._word, self._weight))
        self._keyframe[entries] = len(self.bags)
        self._word[entries], self._weight[entries] = bag.word, bag.weight
        self._held = entries.stop
        self.bags.append(bag)

    def keep_only(self, alive: Array) -> None:
        """Forget what keyframes that are gone looked like: (K,) bool, those that are not."""
        stays = alive[self._keyframe[:self._held]]
        if stays.all():
            return
        held = int(np.count_nonzero(stays))
        for entries in (self._keyframe, self._word, self._weight):
            entries[:held] = entries[:self._held][stays]
        self._held = held
        for number in np.flatnonzero(~alive):
            self.bags[number] = Bag(np.zeros(0, np.int64), np.zeros(0))

    def scores(self, bag: Bag) -> Array:
        """(K,) likeness of each keyframe, 0 to 1: what both bags have in common, Σ min(v, w).

        This is DBoW2's 1 − ½ |v − w|₁.
        """
        seen = np.zeros(len(self.vocabulary.idf))
        seen[bag.word] = bag.weight
        in_common = np.minimum(seen[self._word[:self._held]], self._weight[:self._held])
        return np.bincount(self._keyframe[:self._held], in_common, minlength=len(self.bags))

    def most_like(self, descriptor: Array, count: int) -> Array:
        """Numbers of the keyframes most like an image with these descriptors, best first."""
        scores = self.scores(self.vocabulary.bag(descriptor))
        best = np.argsort(-scores, kind="stable")[:count]
        return np.asarray(best[scores[best] > 0.0])
