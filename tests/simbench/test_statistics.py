"""Intervals and tests: known answers, and how often they are right."""

import numpy as np
import pytest

from simbench.statistics import mean_interval, seeds_needed


def test_an_interval_holds_its_mean_and_equal_values_have_none():
    found = mean_interval([1.0, 2.0, 3.0, 4.0])
    assert found.low < found.mean == 2.5 < found.high
    assert found == mean_interval([1.0, 2.0, 3.0, 4.0])
    same = mean_interval([0.1, 0.1, 0.1])
    assert (same.low, same.high) == pytest.approx((0.1, 0.1), abs=1e-15)
    alone = mean_interval([3.0])
    assert (alone.low, alone.high, alone.n) == (None, None, 1)
    with pytest.raises(ValueError, match="no values"):
        mean_interval([])


def test_an_interval_of_many_values_is_that_of_the_normal_distribution():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    found = mean_interval(values)
    half = 1.96 * values.std(ddof=1) / 20.0
    assert found.high - found.mean == pytest.approx(half, rel=0.1)
    assert found.mean - found.low == pytest.approx(half, rel=0.1)


def test_the_number_of_seeds_makes_the_interval_as_narrow_as_wanted():
    rng = np.random.default_rng(0)
    values = rng.normal(1.0, 0.2, 2000)
    n = seeds_needed(values, 0.05)
    assert n == pytest.approx((1.96 * 0.2 / 0.05) ** 2, rel=0.1)
    assert seeds_needed([1.0, 1.0], 0.05) == 2
    assert seeds_needed([1.0], 0.05) is None
