import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from slam.geometry.arrays import Array, ShapeError, check_shape, freeze_fields


@dataclass(frozen=True, slots=True)
class Pairs:
    left: Array
    right: Array | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, left=("N", 2), right=("N",))


@pytest.mark.parametrize(("shape", "wanted"), [
    ((), ()), ((3,), (3,)), ((7, 3), ("N", 3)), ((0, 3), ("N", 3)), ((4, 4), ("N", "N")),
])
def test_a_fitting_shape_passes(shape, wanted):
    check_shape("x", np.zeros(shape), wanted)


@pytest.mark.parametrize(("shape", "wanted", "message"), [
    ((3,), (4,), "x: wanted shape (4), got (3,)"),
    ((3, 4), (4, 4), "x: wanted shape (4, 4), got (3, 4)"),
    ((7, 2), ("N", 3), "x: wanted shape (N=7, 3), got (7, 2)"),
    ((7,), ("N", 3), "x: wanted shape (N, 3), got (7,)"),
    ((2, 3), ("N", "N"), "x: wanted shape (N=2, N=2), got (2, 3)"),
])
def test_the_message_names_field_wanted_and_got(shape, wanted, message):
    with pytest.raises(ShapeError) as caught:
        check_shape("x", np.zeros(shape), wanted)
    assert str(caught.value) == message


def test_a_letter_means_one_size_over_several_arrays():
    sizes: dict[str, int] = {}
    check_shape("a", np.zeros((5, 2)), ("N", 2), sizes)
    with pytest.raises(ShapeError, match=r"b: wanted shape \(N=5\), got \(4,\)"):
        check_shape("b", np.zeros(4), ("N",), sizes)


def test_a_field_of_another_length_is_named_with_its_type():
    with pytest.raises(ShapeError, match=r"Pairs\.right: wanted shape \(N=3\), got \(2,\)"):
        Pairs(left=np.zeros((3, 2)), right=np.zeros(2))


def test_frozen_arrays_cannot_be_written_through_the_type():
    pairs = Pairs(left=np.zeros((3, 2)))
    with pytest.raises(ValueError, match="read-only"):
        pairs.left[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        pairs.left = np.ones((3, 2))


def test_freezing_leaves_the_callers_array_writable_and_copies_nothing():
    mine = np.zeros((3, 2))
    pairs = Pairs(left=mine)
    mine[0, 0] = 1.0
    assert np.shares_memory(pairs.left, mine)


def test_absent_and_listed_fields():
    pairs = Pairs(left=[[1, 2], [3, 4]])
    assert pairs.right is None
    assert isinstance(pairs.left, np.ndarray)
