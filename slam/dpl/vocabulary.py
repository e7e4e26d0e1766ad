"""Words for ORB descriptors: a tree of binary centres, and images as weighted bags of words.

The tree was grown by scripts/train_vocabulary.py from pictures of our own scenes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from slam.dpl.matching import as_words
from slam.geometry.arrays import Array, freeze_fields

_FILE = "vocabulary.npz"


@dataclass(frozen=True, slots=True)
class Bag:
    """An image as W weighted words; the weights sum to 1, or there are none."""

    word: Array          # (W,) int64, ascending
    weight: Array        # (W,)

    def __post_init__(self) -> None:
        freeze_fields(self, word=("W",), weight=("W",))


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """A complete tree: every node of all levels but the last has `branching` children."""

    centre: Array        # (nodes, 4) uint64: level by level, the leaves (the words) last
    branching: int
    idf: Array           # (words,) log of (images / images with the word), of the training

    def __post_init__(self) -> None:
        freeze_fields(self, centre=("nodes", 4), idf=("words",))

    def words_of(self, descriptor: Array) -> Array:
        """(N,) int64 word of each descriptor (N, 32) uint8: down the tree by nearest centres."""
        bits = as_words(descriptor)
        at, start, size = np.zeros(len(bits), np.int64), 0, self.branching
        while True:
            child = at[:, None] * self.branching + np.arange(self.branching)
            apart = np.bitwise_count(bits[:, None] ^ self.centre[start + child]).sum(axis=2)
            at = child[np.arange(len(bits)), apart.argmin(axis=1)]
            if size >= len(self.idf):
                return at
            start, size = start + size, size * self.branching

    def bag(self, descriptor: Array) -> Bag:
        """The words of an image's descriptors (N, 32) uint8, weighted by tf-idf."""
        word, count = np.unique(self.words_of(descriptor), return_counts=True)
        weight = count * self.idf[word]
        known = weight > 0.0
        return Bag(word[known], weight[known] / max(weight.sum(), 1e-12))


@cache
def shipped() -> Vocabulary:
    """The vocabulary that comes with the package."""
    with resources.files("slam.dpl").joinpath(_FILE).open("rb") as file, \
            np.load(file, allow_pickle=False) as held:
        return Vocabulary(as_words(held["centre"]), int(held["branching"]),
                          held["idf"].astype(np.float64))
