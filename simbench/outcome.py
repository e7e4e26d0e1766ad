"""What a run came to, as a command tells it and metrics.json begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simbench.sequence import Sequence


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a command tells of a run."""

    metrics: Mapping[str, Any]
    log: tuple[str, ...]
    frames: int
    lost: int
    warnings: tuple[str, ...] = ()   # what to tell besides the tables
    failure: str = ""                # the system lost the whole run; why


def head(system: str, sequence: Sequence, frames: int) -> dict[str, Any]:
    """What metrics.json says of the run itself."""
    return {"system": system, "sequence": {"name": sequence.name, "frames": frames,
                                           "sha256": sequence.fingerprint()}}
