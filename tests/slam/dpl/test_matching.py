"""Binary descriptors find their like: nearby, everywhere, along lines."""

import numpy as np
from numpy.testing import assert_array_equal

from slam.dpl.matching import as_words, distances, match_all, match_lines_near, match_near

RNG = np.random.default_rng(0)
WORDS = as_words(RNG.integers(0, 256, (60, 32), dtype=np.uint8))
UV = RNG.uniform(0, 300, (60, 2))
LEVEL = np.zeros(60, np.int32)


def flipped(words, bits):
    """The same descriptors with so many bits changed."""
    raw = np.unpackbits(words.view(np.uint8).reshape(len(words), 32), axis=1)
    raw[:, :bits] ^= 1
    return as_words(np.packbits(raw, axis=1))


def test_distances_count_bits():
    assert_array_equal(distances(WORDS, flipped(WORDS, 37)), 37)


def test_shuffled_points_are_found_again_both_ways():
    order = RNG.permutation(60)
    match = match_all(WORDS, flipped(WORDS, 20)[order], 60, 0.8)
    assert_array_equal(order[match], np.arange(60))


def test_points_are_sought_near_where_they_are_expected_only():
    seen = UV + 3.0
    assert_array_equal(match_near(UV, WORDS, np.full(60, 8.0), LEVEL, seen, WORDS, LEVEL, 50, 0.9),
                       np.arange(60))
    far = match_near(UV, WORDS, np.full(60, 3.0), LEVEL, seen, WORDS, LEVEL, 50, 0.9)
    assert_array_equal(far, -1)       # 3 √2 px away
    assert_array_equal(match_near(UV, WORDS, np.full(60, 8.0), LEVEL, seen, WORDS, LEVEL + 2, 50,
                                  0.9), -1)


def test_a_seen_point_serves_one_expected_point_and_nan_none():
    expected = np.repeat(UV[:1], 3, axis=0)
    expected[2] = np.nan
    words = np.concatenate([flipped(WORDS[:1], 9), WORDS[:1], WORDS[:1]])
    match = match_near(expected, words, np.full(3, 8.0), LEVEL[:3], UV[:1], WORDS[:1], LEVEL[:1],
                       50, 0.9)
    assert_array_equal(match, [-1, 0, -1])


def test_lines_match_along_themselves_but_not_across():
    a = np.array([[[10.0, 10.0], [110.0, 10.0]], [[10.0, 50.0], [110.0, 90.0]]])
    slid = a + np.array([[[20.0, 1.0]], [[10.0, 4.0]]])       # the second along itself
    assert_array_equal(match_lines_near(a, WORDS[:2], slid[::-1], WORDS[:2][::-1], 5.0, 60), [1, 0])
    across = a + np.array([0.0, 9.0])
    assert_array_equal(match_lines_near(a, WORDS[:2], across, WORDS[:2], 5.0, 60), [-1, -1])
    assert_array_equal(match_lines_near(a, WORDS[:2], a, WORDS[2:4], 5.0, 60), [-1, -1])
