"""Maps as PLY."""

import numpy as np
from numpy.testing import assert_allclose

from simbench.ply import ply_text


def test_points_are_vertices_and_lines_are_edges_between_theirs():
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [4.0, 5.0, 6.0]])
    lines = np.arange(12.0).reshape(2, 2, 3)
    head, _, body = ply_text(points, lines).partition("end_header\n")
    assert head.startswith("ply\nformat ascii 1.0\n")
    assert "element vertex 6\n" in head
    assert "element edge 2\n" in head
    rows = body.splitlines()
    vertices = np.array([row.split() for row in rows[:6]], dtype=float)
    edges = np.array([row.split() for row in rows[6:]], dtype=int)
    assert_allclose(vertices[:2], points[[0, 2]])
    assert_allclose(vertices[edges], lines)
