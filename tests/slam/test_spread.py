"""Noise of known size is found again, with and without points far off."""

import numpy as np
import pytest

from slam.geometry.segment import unit_normals
from slam.spread import sigma_of_distances, sigma_of_lengths

NOISE = np.random.default_rng(0).normal(size=(20_000, 2)) * 0.7


def test_the_spread_of_distances_along_one_direction():
    assert sigma_of_distances(NOISE[:, 0]) == pytest.approx(0.7, rel=0.02)
    assert sigma_of_distances(np.append(NOISE[:, 0], np.full(200, 1e3))) == pytest.approx(
        0.7, rel=0.04)


def test_lengths_in_a_plane_spread_by_less_than_distances_of_one_direction_would():
    lengths = np.linalg.norm(NOISE, axis=1)
    assert sigma_of_lengths(lengths) == pytest.approx(0.7, rel=0.02)
    assert sigma_of_distances(lengths) == pytest.approx(1.75 * 0.7, rel=0.02)   # the wrong one


def test_unit_normals_stand_across():
    ends = np.array([[[0.0, 0.0], [3.0, 4.0]], [[1.0, 1.0], [1.0, 1.0]]])
    assert np.allclose(unit_normals(ends), [[-0.8, 0.6], [0.0, 0.0]])
