"""Sequences in the layouts that other programs read."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from simbench.errors import UnknownName
from simbench.export.kitti import export_kitti
from simbench.export.rosbag import export_rosbag2
from simbench.export.target import make_folder
from simbench.export.tum import export_tum
from simbench.export.vdo import export_vdo
from simbench.sequence import Sequence

Exporter = Callable[[Sequence, Path, Callable[[], None]], None]

EXPORTERS: dict[str, Exporter] = {"tum": export_tum, "vdo": export_vdo, "kitti": export_kitti,
                                  "rosbag2": export_rosbag2}


def find_exporter(layout: str) -> Exporter:
    """What writes a layout: `exporter(sequence, out, on_frame)`. Raises UnknownName."""
    if layout not in EXPORTERS:
        raise UnknownName(f"--format {layout}: no such layout; there are {', '.join(EXPORTERS)}")
    return EXPORTERS[layout]


def export_whole(layout: str, sequence: Sequence, out: Path,
                 on_frame: Callable[[], None] = lambda: None) -> None:
    """Write a layout so that `out` is there whole, or as it was.

    Raises:
        UnknownName: there is no such layout.
        UserError: the folder is not empty, or the sequence lacks what the layout needs.
        BadFrame: a frame cannot be read.
    """
    exporter = find_exporter(layout)
    make_folder(out)
    scratch = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        exporter(sequence, scratch / out.name, on_frame)
        out.rmdir()
        (scratch / out.name).rename(out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
