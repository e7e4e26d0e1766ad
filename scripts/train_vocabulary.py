"""Grow the vocabulary of place recognition from pictures of our own scenes.

    python scripts/train_vocabulary.py [--out slam/dpl/vocabulary.npz] [--scenes A B] [--seeds 6]
        [--pictures 12] [--branching 10] [--levels 4]

ORB descriptors of all pictures are split into `branching` clusters, each of these again, and so on:
k-means on bits, where a centre is the majority of its members' bits. The leaves are the words; a
word's weight is log(pictures / pictures that hold it). Equal arguments give equal bytes.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from simbench.render import make_renderer
from simbench.storage import write_bytes
from simbench.world import make_world
from slam.dpl.config import OrbConfig
from slam.dpl.orb import OrbDetector
from slam.dpl.vocabulary import Vocabulary
from slam.geometry.arrays import Array

SCENES = ("SwingingBoxes-v0", "Street-v0", "Office-v0", "Loop-v0", "Corridor-v0")
FIRST_SEED = 1000        # far from the seeds of any evaluation
_PAUSE_S = 2.0           # between pictures of one world
_ROUNDS = 12
_POINTS = 1000           # of a picture


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("slam/dpl/vocabulary.npz"))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--pictures", type=int, default=12)
    parser.add_argument("--branching", type=int, default=10)
    parser.add_argument("--levels", type=int, default=4)
    given = parser.parse_args(arguments)
    pictures = list(descriptors(given.scenes, given.seeds, given.pictures))
    centre = grow(np.concatenate(pictures), given.branching, given.levels)
    words = given.branching ** given.levels
    blank = Vocabulary(centre.view(np.uint64), given.branching, np.zeros(words))
    held = np.zeros(words)
    for each in pictures:
        held[np.unique(blank.words_of(each))] += 1
    idf = np.log(len(pictures) / np.maximum(held, 1.0)).astype(np.float32)
    file = io.BytesIO()
    np.savez_compressed(file, centre=centre, branching=given.branching, idf=idf)
    write_bytes(given.out, file.getvalue())
    print(f"{given.out}: {words} words of {sum(map(len, pictures))} descriptors in "
          f"{len(pictures)} pictures; {np.mean(held > 0):.0%} occur, "
          f"{given.out.stat().st_size / 1000:.0f} kB")


def descriptors(scenes: Sequence[str], seeds: int, pictures: int) -> Iterator[Array]:
    """(N, 32) uint8 of each picture."""
    detector = OrbDetector(OrbConfig(count=_POINTS))
    for scene in scenes:
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            world = make_world(scene, seed)
            renderer = make_renderer("mujoco", world)
            for k in range(pictures):
                world.advance_to(k * _PAUSE_S)
                gray = np.asarray(cv2.cvtColor(renderer.rgb(world), cv2.COLOR_RGB2GRAY))
                yield detector(gray).descriptor
            renderer.close()


def grow(descriptor: Array, branching: int, levels: int) -> Array:
    """(nodes, 32) uint8 centres of a tree over descriptors (N, 32), level by level."""
    bits = np.unpackbits(descriptor, axis=1).astype(np.float32)
    rng = np.random.default_rng(0)
    group, out = np.zeros(len(bits), np.int64), []
    for level in range(levels):
        centres = np.zeros((branching ** level, branching, 256), np.float32)
        child = np.zeros(len(bits), np.int64)
        for node in range(branching ** level):
            mine = np.flatnonzero(group == node)
            if len(mine):
                centres[node], child[mine] = cluster(bits[mine], branching, rng)
        group = group * branching + child
        out.append(np.packbits(centres.reshape(-1, 256) > 0.5, axis=1))
    return np.concatenate(out)


def cluster(bits: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """k-means on bits (N, 256): centres (count, 256) of 0 and 1, and each row's own (N,)."""
    centres = bits[_far_apart(bits, count, rng)]
    own = np.zeros(len(bits), np.int64)
    for _ in range(_ROUNDS):
        before, own = own, _distances(bits, centres).argmin(axis=1)
        if np.array_equal(before, own):
            break
        for c in np.unique(own):
            centres[c] = bits[own == c].mean(axis=0) > 0.5
    return centres, own


def _far_apart(bits: Array, count: int, rng: np.random.Generator) -> Array:
    """Rows to begin with: each drawn by its squared distance to those drawn before (k-means++)."""
    rows = [int(rng.integers(len(bits)))]
    nearest = _distances(bits, bits[rows])[:, 0]
    while len(rows) < count:
        share = nearest.astype(np.float64) ** 2
        row = int(rng.choice(len(bits), p=share / share.sum())) if share.sum() > 0 else rows[0]
        rows.append(row)
        nearest = np.minimum(nearest, _distances(bits, bits[[row]])[:, 0])
    return np.array(rows)


def _distances(bits: Array, centres: Array) -> Array:
    """(N, C) bits that differ."""
    return bits.sum(axis=1)[:, None] + centres.sum(axis=1) - 2.0 * (bits @ centres.T)


if __name__ == "__main__":
    main()
