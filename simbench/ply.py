"""A map of points and lines as PLY text, which mesh viewers read (CloudCompare, MeshLab)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simbench.errors import BadFile
from simbench.untrusted import read_text
from slam.geometry.arrays import Array

_VERTEX, _EDGE = "element vertex ", "element edge "


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
            f"{_VERTEX}{len(vertices)}", "property float x", "property float y",
            "property float z", f"{_EDGE}{len(lines)}", "property int vertex1",
            "property int vertex2", "end_header"]
    return "\n".join([*head, *rows, *edges]) + "\n"


def read_ply(path: Path) -> tuple[Array, Array]:
    """Points (P, 3) and lines (L, 2, 3) of a map that `ply_text` wrote, in metres.

    Raises:
        BadFile: it is missing, or not such a map.
    """
    head, end, body = read_text(path).partition("end_header\n")
    counts = {key: _count(head, key) for key in (_VERTEX, _EDGE)}
    rows = body.splitlines()
    if not end or None in counts.values() or len(rows) != sum(n or 0 for n in counts.values()):
        raise BadFile(f"{path}: not a map of this program; run the system again")
    vertex_rows = rows[:counts[_VERTEX]]
    try:
        vertices = np.array([row.split() for row in vertex_rows], np.float64).reshape(-1, 3)
        edges = np.array([row.split() for row in rows[len(vertex_rows):]], np.int64).reshape(-1, 2)
    except (ValueError, OverflowError):
        raise BadFile(f"{path}: a row is broken; run the system again") from None
    if np.any((edges < 0) | (edges >= len(vertices))) or not np.isfinite(vertices).all():
        raise BadFile(f"{path}: an edge is of no vertex, or a number is not finite; run the "
                      "system again")
    alone = np.ones(len(vertices), bool)
    alone[edges] = False
    return vertices[alone], vertices[edges]


def _count(head: str, key: str) -> int | None:
    words = [line.removeprefix(key) for line in head.splitlines() if line.startswith(key)]
    known = len(words) == 1 and words[0].isascii() and words[0].isdecimal() and len(words[0]) < 10
    return int(words[0]) if known else None
