"""Masks followed by flow: whatever the labels are called, and what is missed or split."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.dynamics.masks import associate, overlaps
from slam.frontend.observe import observe
from slam.types import FlowField, Frame, Intrinsics

SIZE = (90, 120)
CAMERA = Intrinsics(100.0, 100.0, 59.5, 44.5, SIZE[1], SIZE[0])
BOXES = {7: (10, 10), 8: (10, 60), 900_000_007: (55, 30)}   # label -> row, column of its corner


def image(boxes, shift=(0, 0), side=24):
    labels = np.zeros(SIZE, np.int32)
    for label, (row, column) in boxes.items():
        labels[row + shift[1]:row + shift[1] + side, column + shift[0]:column + shift[0] + side] \
            = label
    return labels


def observed(labels):
    return observe(Frame(0, 0.0, np.zeros((*SIZE, 3), np.uint8), np.ones(SIZE, np.float32),
                         CAMERA, labels))


def followed(labels_a, labels_b, flow, min_share=0.3):
    a, b = observed(labels_a), observed(labels_b)
    return associate(overlaps(flow, a.label_index, b.label_index), a.labels, b.labels, min_share)


def constant_flow(u, v):
    return FlowField(np.broadcast_to(np.array([u, v], np.float32), (*SIZE, 2)))


@given(st.permutations([3, 5_000_000, 41]), st.integers(-8, 8), st.integers(-8, 8))
@settings(max_examples=30)
def test_labels_shuffled_between_frames_are_followed(names, u, v):
    renamed = dict(zip(names, BOXES.values(), strict=True))
    pairs = followed(image(BOXES), image(renamed, (u, v)), constant_flow(u, v))
    assert pairs == dict(zip(names, BOXES, strict=True))


def test_two_objects_that_swap_labels_keep_their_identity():
    swapped = {7: BOXES[8], 8: BOXES[7]}
    pairs = followed(image({k: BOXES[k] for k in (7, 8)}), image(swapped), constant_flow(0, 0))
    assert pairs == {7: 8, 8: 7}


def test_a_missed_mask_has_no_successor_and_a_new_one_no_predecessor():
    now = {8: BOXES[8], 55: (60, 90)}
    assert followed(image(BOXES), image(now), constant_flow(0, 0)) == {8: 8}


def test_a_split_mask_goes_on_as_its_larger_part():
    split = image({7: BOXES[7]})
    split[:, 10:16][split[:, 10:16] == 7] = 99
    assert followed(image({7: BOXES[7]}), split, constant_flow(0, 0)) == {7: 7}


def test_merged_masks_go_on_as_the_larger_of_them():
    both = image({7: BOXES[7], 8: (10, 34)})
    both[10:34, 34:46] = 7                       # 7 has 36 columns now, 8 has 12
    assert followed(both, np.where(both > 0, 5, 0), constant_flow(0, 0)) == {5: 7}


def test_masks_that_the_flow_does_not_reach_are_not_paired():
    moved = image(BOXES, (20, 8))
    assert followed(image(BOXES), moved, constant_flow(-8, 0), 0.3) == {}


def test_flow_that_is_unknown_or_not_finite_carries_nothing():
    nothing = np.full((*SIZE, 2), np.nan, np.float32)
    assert followed(image(BOXES), image(BOXES), FlowField(nothing)) == {}
    huge = FlowField(np.full((*SIZE, 2), 1e30, np.float32))
    assert followed(image(BOXES), image(BOXES), huge) == {}
    invalid = FlowField(np.zeros((*SIZE, 2), np.float32), np.zeros(SIZE, bool))
    assert followed(image(BOXES), image(BOXES), invalid) == {}


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_pairs_are_one_to_one_and_never_the_background(share, seed):
    rng = np.random.default_rng(seed)
    a, b = (np.kron(rng.integers(0, 6, (9, 12)), np.ones((10, 10), int)).astype(np.int32)
            for _ in range(2))
    flow = FlowField(rng.normal(scale=6.0, size=(*SIZE, 2)).astype(np.float32))
    pairs = followed(a, b, flow, share)
    assert len(set(pairs.values())) == len(pairs)
    assert 0 not in pairs
    assert 0 not in pairs.values()
    assert set(pairs) <= set(np.unique(b))
    assert set(pairs.values()) <= set(np.unique(a))
