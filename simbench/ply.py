"""A map of points and lines as PLY text, which mesh viewers read (CloudCompare, MeshLab)."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array


def ply_text(points_world: Array, lines_world: Array) -> str:
    """ASCII PLY: map points (P, 3) as vertices, lines (L, 2, 3) as edges between theirs; metres.

    What is not finite is left out. The vertices of points come first.
    """
    points = points_world[np.isfinite(points_world).all(axis=1)]
    lines = lines_world[np.isfinite(lines_world).all(axis=(1, 2))]
    vertices = np.concatenate([points, lines.reshape(-1, 3)])
    first = len(points) + 2 * np.arange(len(lines))
    rows = [f"{x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices.tolist()]
    edges = [f"{i} {i + 1}" for i in first.tolist()]
    head = ["ply", "format ascii 1.0", "comment map in the world of the estimate, metres",
            f"element vertex {len(vertices)}", "property float x", "property float y",
            "property float z", f"element edge {len(lines)}", "property int vertex1",
            "property int vertex2", "end_header"]
    return "\n".join([*head, *rows, *edges]) + "\n"
