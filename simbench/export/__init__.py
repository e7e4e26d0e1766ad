"""Sequences in the layouts that other programs read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from simbench.errors import UnknownName
from simbench.export.tum import export_tum
from simbench.export.vdo import export_vdo
from simbench.sequence import Sequence

Exporter = Callable[[Sequence, Path, Callable[[], None]], None]

EXPORTERS: dict[str, Exporter] = {"tum": export_tum, "vdo": export_vdo}


def find_exporter(layout: str) -> Exporter:
    """What writes a layout: `exporter(sequence, out, on_frame)`. Raises UnknownName."""
    if layout not in EXPORTERS:
        raise UnknownName(f"--format {layout}: no such layout; there are {', '.join(EXPORTERS)}")
    return EXPORTERS[layout]
