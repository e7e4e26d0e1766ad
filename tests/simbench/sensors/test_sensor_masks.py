"""Masks: erosion, missed objects, shuffled labels and whose label is whose."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simbench.errors import UserError
from simbench.sensors import (
    MaskNoise,
    Stage,
    generator,
    majority_objects,
    mask_noise,
    shuffle_labels,
)


def rng(frame: int = 0) -> np.random.Generator:
    return generator(3, Stage.MASKS, frame)


@pytest.fixture
def masks() -> np.ndarray:
    image = np.zeros((100, 140), np.int32)
    image[20:60, 20:60] = 4
    image[30:90, 60:100] = 9      # touches object 4
    image[2:6, 120:130] = 2
    image.flags.writeable = False
    return image


def test_erosion_shrinks_every_object_by_its_pixels(masks):
    eroded = mask_noise(masks, MaskNoise(erosion_px=2, missed=0.0), rng())
    assert (eroded == 4).sum() == 36 * 36       # the touching side shrinks, too
    assert ((eroded == 0) | (eroded == masks)).all()


def test_negative_erosion_grows_over_background_only(masks):
    grown = mask_noise(masks, MaskNoise(erosion_px=-2, missed=0.0), rng())
    np.testing.assert_array_equal(grown[masks > 0], masks[masks > 0])
    assert grown[18, 40] == 4
    assert grown[17, 40] == 0
    assert (grown == 2).sum() > (masks == 2).sum()


def test_objects_are_missed_with_their_probability(masks):
    noise = MaskNoise(erosion_px=0, missed=0.3)
    seen = [len(np.unique(mask_noise(masks, noise, rng(k)))) - 1 for k in range(400)]
    assert np.mean(seen) / 3 == pytest.approx(0.7, abs=0.04)


@given(st.lists(st.integers(0, 60_000), min_size=4, max_size=4), st.integers(0, 1000))
def test_shuffling_can_be_undone_by_its_map(ids, seed):
    image = np.array(ids, np.int32).reshape(2, 2)
    labels, true_of = shuffle_labels(image, np.random.default_rng(seed))
    undone = np.array([true_of.get(int(x), 0) for x in labels.ravel()]).reshape(2, 2)
    np.testing.assert_array_equal(undone, image)
    assert sorted(true_of) == list(range(1, len(true_of) + 1))
    assert labels.dtype == np.int32


def test_labels_change_from_frame_to_frame(masks):
    maps = {tuple(sorted(shuffle_labels(masks, rng(k))[1].items())) for k in range(40)}
    assert len(maps) == 6      # all orders of three objects


def test_the_majority_decides_whose_label_it_is():
    labels = np.array([[1, 1, 1, 2], [2, 2, 5, 5], [7, 7, 0, 0]])
    true = np.array([[3, 3, 8, 8], [8, 0, 0, 0], [3, 3, 9, 9]])
    assert majority_objects(labels, true) == {1: 3, 2: 8, 7: 3}
    assert majority_objects(np.zeros((2, 2), np.int32), np.ones((2, 2), np.int32)) == {}


@given(st.integers(0, 10_000))
def test_the_majority_agrees_with_counting(seed):
    generator_ = np.random.default_rng(seed)
    labels, true = generator_.integers(0, 4, (2, 9, 7))
    found = majority_objects(labels, true)
    for label in range(1, 4):
        counts = np.bincount(true[labels == label], minlength=4)
        best = int(np.argmax(counts)) if counts.any() else 0
        assert found.get(label, 0) == best


def test_a_probability_beyond_one_is_refused():
    with pytest.raises(UserError, match="missed"):
        MaskNoise(missed=1.5)
