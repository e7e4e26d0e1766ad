"""Points where rays meet."""

import numpy as np
from numpy.testing import assert_allclose

from slam.dpl.triangulate import midpoints


def test_rays_to_a_point_meet_there_at_its_parallax():
    rng = np.random.default_rng(0)
    xyz = rng.uniform([-1, -1, 3], [1, 1, 6], (20, 3))
    a, b = np.zeros(3), np.array([0.5, 0.1, 0.0])
    found, parallax_deg = midpoints(a, xyz - a, b, (xyz - b) * 2.0)
    assert_allclose(found, xyz, atol=1e-9)
    one, two = xyz - a, xyz - b
    cosine = np.sum(one * two, 1) / np.linalg.norm(one, axis=1) / np.linalg.norm(two, axis=1)
    assert_allclose(parallax_deg, np.degrees(np.arccos(cosine)), atol=1e-6)


def test_rays_that_part_have_no_parallax():
    a, b = np.zeros(3), np.array([1.0, 0.0, 0.0])
    _, parallax_deg = midpoints(a, np.array([[-0.2, 0.0, 1.0]]), b, np.array([[0.2, 0.0, 1.0]]))
    assert parallax_deg[0] == 0.0
