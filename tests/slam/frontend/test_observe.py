"""Frames prepared: grey, inverse depth and compact labels, whatever the input holds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slam.frontend.observe import NO_GROUP, observe
from slam.types import Frame, Intrinsics

CAMERA = Intrinsics(30.0, 30.0, 15.5, 11.5, 32, 24)


def frame(labels=None, depth=None):
    depth = np.full((24, 32), 2.0, np.float32) if depth is None else depth
    return Frame(0, 0.0, np.full((24, 32, 3), 128, np.uint8), depth, CAMERA, labels)


def test_inverse_depth_is_zero_wherever_depth_is_not_a_length():
    depth = np.full((24, 32), 4.0, np.float32)
    depth[0, :5] = [0.0, -1.0, np.nan, np.inf, -np.inf]
    rho = observe(frame(depth=depth)).rho
    assert_array_equal(rho[0, :5], 0.0)
    assert_allclose(rho[0, 5:], 0.25)


def test_a_depth_too_small_to_be_one_stays_finite():
    depth = np.full((24, 32), 1e-42, np.float32)         # denormal: 1/z is beyond float32
    assert np.isfinite(observe(frame(depth=depth)).rho).all()


def test_no_masks_and_empty_masks_are_background():
    for labels in (None, np.zeros((24, 32), np.int32)):
        seen = observe(frame(labels))
        assert_array_equal(seen.labels, [0])
        assert not seen.label_index.any()
        assert not seen.groups({}).any()


@pytest.mark.parametrize("names", [(3, 9), (3, 2**31 - 1), (1_000_000, 999_999)])
def test_labels_of_any_size_are_numbered(names):
    labels = np.zeros((24, 32), np.int32)
    labels[2:8, 2:8], labels[10:20, 10:20] = names
    seen = observe(frame(labels))
    assert set(seen.labels) == {0, *names}
    assert_array_equal(seen.labels[seen.label_index], labels)
    groups = seen.groups({names[1]: 1})
    assert_array_equal(groups[labels == names[1]], 1)
    assert_array_equal(groups[labels == names[0]], NO_GROUP)
    assert_array_equal(groups[labels == 0], 0)


def test_negative_labels_are_background():
    labels = np.full((24, 32), -1, np.int32)
    labels[4:8, 4:8] = 5
    seen = observe(frame(labels))
    assert_array_equal(seen.labels, [0, 5])
    assert_array_equal(seen.label_index, labels == 5)


@pytest.mark.parametrize("factor", [1, 5_000_000])
def test_of_more_masks_than_fit_the_largest_are_kept_and_the_rest_belong_to_nothing(factor):
    labels = np.zeros((24, 32), np.int32)
    labels.flat[:300] = np.arange(1, 301)
    labels.flat[300:310] = 300                            # the largest has the last number
    seen = observe(frame(labels * factor))
    assert len(seen.labels) == 255
    assert 300 * factor in seen.labels
    groups = seen.groups({300 * factor: 1})
    assert np.count_nonzero(groups == 1) == 11
    assert_array_equal(groups.flat[310:], 0)
    assert np.count_nonzero(groups == NO_GROUP) == 299
