"""The vocabulary that is shipped, and the index of places."""

from importlib import resources

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slam.dpl.matching import as_words
from slam.dpl.recognise import PlaceIndex
from slam.dpl.vocabulary import Vocabulary, shipped


def descriptors(seed, count=300):
    return np.random.default_rng(seed).integers(0, 256, (count, 32), dtype=np.uint8)


def with_flipped_bits(descriptor, seed, bits=10):
    """What another view of the same points may look like."""
    rng = np.random.default_rng(seed)
    flipped = np.unpackbits(descriptor, axis=1)
    for row in flipped:
        row[rng.choice(256, bits, replace=False)] ^= 1
    return np.packbits(flipped, axis=1)


def test_the_shipped_vocabulary_is_small_and_whole():
    vocabulary = shipped()
    file = resources.files("slam.dpl").joinpath("vocabulary.npz")
    assert len(file.read_bytes()) < 500_000
    levels = round(np.log(len(vocabulary.idf)) / np.log(vocabulary.branching))
    assert len(vocabulary.centre) == sum(vocabulary.branching ** (i + 1) for i in range(levels))
    assert (vocabulary.idf >= 0).all()


def test_a_word_is_found_by_going_to_the_nearest_child_at_each_level():
    centre = descriptors(3, 3 + 9)
    vocabulary = Vocabulary(as_words(centre), 3, np.ones(9))
    bits = np.unpackbits(centre, axis=1).astype(int)
    for one, word in zip(descriptors(4, 20), vocabulary.words_of(descriptors(4, 20)), strict=True):
        own = np.unpackbits(one).astype(int)
        top = int(np.abs(bits[:3] - own).sum(axis=1).argmin())
        children = bits[3 + 3 * top:3 + 3 * top + 3]
        assert word == 3 * top + int(np.abs(children - own).sum(axis=1).argmin())


def test_a_bag_weighs_one_and_an_empty_image_has_none():
    bag = shipped().bag(descriptors(0))
    assert_allclose(bag.weight.sum(), 1.0)
    assert (np.diff(bag.word) > 0).all()
    assert not len(shipped().bag(np.zeros((0, 32), np.uint8)).word)


def test_scores_are_the_common_part_of_two_bags():
    index = PlaceIndex()
    for seed in range(3):
        index.add(descriptors(seed))
    a, b = index.bags[0], index.bags[1]
    dense = np.zeros((2, len(index.vocabulary.idf)))
    dense[0, a.word], dense[1, b.word] = a.weight, b.weight
    scores = index.scores(a)
    assert_allclose(scores[0], 1.0)
    assert_allclose(scores[1], 1.0 - 0.5 * np.abs(dense[0] - dense[1]).sum())


@pytest.mark.parametrize("seed", range(4))
def test_a_place_seen_again_is_the_most_like(seed):
    index = PlaceIndex()
    for other in range(20):
        index.add(descriptors(other))
    again = with_flipped_bits(descriptors(seed)[:200], seed)
    assert index.most_like(again, 3)[0] == seed
    assert_array_equal(index.most_like(np.zeros((0, 32), np.uint8), 3), np.zeros(0, int))


def test_keyframes_that_are_gone_are_like_nothing_and_take_no_room():
    index = PlaceIndex()
    for seed in range(4):
        index.add(descriptors(seed))
    before, held = index.scores(index.bags[3]), index._held
    index.keep_only(np.array([True, False, True, True]))
    after = index.scores(index.bags[3])
    assert_array_equal(after, np.where([True, False, True, True], before, 0.0))
    assert index._held < held
    index.add(descriptors(1))
    assert index.most_like(descriptors(1), 1).tolist() == [4]
