"""Our values for a paper's table, read from the runs of its suite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simbench.metric_names import flat_metrics
from simbench.reproduce.table import PaperTable, Quantity, Row
from simbench.suites.folder import read_json_object
from simbench.suites.jobs import Run
from simbench.suites.work import FAILED
from simbench.trajectory_files import read_tum_trajectory
from slam.geometry.arrays import Array

AXES = "xyz"


@dataclass(frozen=True, slots=True)
class Counted:
    """How often the systems had no answer."""

    runs: int
    lost_runs: int
    frames: int
    lost_frames: int


@dataclass(frozen=True, slots=True)
class Deviation:
    """Where a run saw a camera that stood still."""

    system: str
    time_s: Array        # (K,) of the frames with a pose
    offset_m: Array      # (K, 3) from the first pose: right, down, forward


class Measured:
    """What the runs of a table's suite say, by case, system and seed.

    Args:
        records: of results.json, one for each run.
        out: the suite's folder.
    """

    def __init__(self, table: PaperTable, runs: Sequence[Run],
                 records: Sequence[Mapping[str, Any]], out: Path) -> None:
        self.systems = tuple(dict.fromkeys(run.system for run in runs))
        self.named = {short_name(system): system for system in self.systems}
        self._records = {(run.case, run.system, run.seed): record
                         for run, record in zip(runs, records, strict=True)}
        self.deviations: list[Deviation] = []
        self._values: dict[tuple[str, str], dict[int, Mapping[str, float]]] = {}
        for run, record in zip(runs, records, strict=True):
            found = {} if record["status"] == FAILED else _values_of(out / run.folder)
            if table.figure == "deviation" and found:
                seen = _deviation(run.system, out / run.folder / "trajectory.txt")
                if seen is not None:
                    found |= _of_deviation(seen)
                    if run.seed == runs[0].seed:
                        self.deviations.append(seen)
            self._values.setdefault((run.case, run.system), {})[run.seed] = found

    def values(self, row: Row, quantity: Quantity, system: str) -> dict[int, float]:
        """The quantity by seed; a seed without it is absent."""
        return self._of(row, quantity.metric, quantity.scale, system)

    def spreads(self, row: Row, quantity: Quantity, system: str) -> dict[int, float]:
        """Its standard deviation over the frames, by seed."""
        return self._of(row, quantity.deviation, quantity.scale, system) \
            if quantity.deviation else {}

    def _of(self, row: Row, metric: str, scale: float, system: str) -> dict[int, float]:
        path = f"{row.of}.{metric}" if row.of else metric
        return {seed: scale * found[path]
                for seed, found in self._values.get((row.case, system), {}).items()
                if path in found}

    def counted(self, case: str, system: str) -> Counted:
        """Lost runs and frames of a case."""
        here = [record for (c, s, _), record in self._records.items() if (c, s) == (case, system)]
        return Counted(len(here), sum(each["status"] != "done" for each in here),
                       sum(each.get("frames", 0) for each in here),
                       sum(each.get("lost_frames", 0) for each in here))


def short_name(system: str) -> str:
    """A system's name as a heading: of path/to/file.py:factory the file's."""
    place, colon, _ = system.rpartition(":")
    return Path(place).stem if colon and place.endswith(".py") else system


def _values_of(folder: Path) -> dict[str, float]:
    """All numbers of a run's metrics.json by dotted names, those of each object among them."""
    metrics = read_json_object(folder / "metrics.json", "begin again in another --out")
    return dict(_dotted("", metrics)) | flat_metrics(metrics)


def _dotted(prefix: str, value: Any) -> list[tuple[str, float]]:
    if isinstance(value, Mapping):
        return [pair for key, inner in value.items()
                for pair in _dotted(f"{prefix}.{key}" if prefix else str(key), inner)]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return [(prefix, float(value))]
    return []


def _deviation(system: str, path: Path) -> Deviation | None:
    """None where the run has no pose at all."""
    stamps_s, T = read_tum_trajectory(path)
    if not len(T):
        return None
    return Deviation(system, stamps_s - stamps_s[0],
                     (T[:, :3, 3] - T[0, :3, 3]) @ T[0, :3, :3])


def _of_deviation(seen: Deviation) -> dict[str, float]:
    out: dict[str, float] = {}
    for i, axis in enumerate(AXES):
        offset = np.abs(seen.offset_m[:, i])
        out |= {f"{axis}.deviation_largest": float(offset.max()),
                f"{axis}.deviation_last": float(offset[-1])}
    return out
