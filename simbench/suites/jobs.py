"""The runs of a suite, and the tasks that workers are given: runs that share their frames."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from simbench.inputs import InputChoice
from simbench.suites.spec import Point, SequenceSpec, Suite, value_text
from simbench.versions import versions

_RUNS_A_TASK = 6     # more would be lost where a worker is killed


@dataclass(frozen=True, slots=True)
class Run:
    """One system on one sequence with one set of inputs."""

    case: str
    point: Point
    seed: int
    system: str
    sequence: SequenceSpec
    choice: InputChoice
    settings: tuple[str, ...]

    def identity(self) -> dict[str, Any]:
        """All that decides its estimates, besides the code itself."""
        return {"sequence": asdict(self.sequence), "seed": self.seed, "system": self.system,
                "inputs": asdict(self.choice), "settings": list(self.settings),
                "versions": versions()}

    @property
    def key(self) -> str:
        """A name for the run's record that changes with its identity."""
        text = json.dumps([self.case, self.point, self.identity()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @property
    def folder(self) -> str:
        """Where the run lies below the suite's folder; readable, and unlike any other run's."""
        point = ",".join(f"{name}={value_text(value)}" for name, value in self.point)
        parts = (self.case, point, self.system, f"seed{self.seed}")
        return "runs/" + "/".join(_slug(part) for part in parts if part)


@dataclass(frozen=True, slots=True)
class Task:
    """Runs on one sequence, done one after another by one worker."""

    sequence: SequenceSpec
    runs: tuple[Run, ...]


def runs_of(suite: Suite) -> list[Run]:
    """Every run of a suite, in the order its results are listed."""
    return [Run(case.name, point, seed, system, here.sequence(seed), here.choice(), here.settings)
            for case, point in suite.cells() for here in [case.at(point)]
            for system in suite.systems for seed in suite.seeds]


def tasks_of(runs: Iterable[Run]) -> list[Task]:
    """The runs joined by their sequences; a task holds at most six."""
    together: dict[SequenceSpec, list[Run]] = {}
    for run in runs:
        together.setdefault(run.sequence, []).append(run)
    return [Task(sequence, tuple(group[i:i + _RUNS_A_TASK]))
            for sequence, group in together.items()
            for i in range(0, len(group), _RUNS_A_TASK)]


def _slug(text: str) -> str:
    """The text as one folder's name; a digest is added where characters had to go."""
    safe = re.sub(r"[^\w.,=+-]+", "_", text).strip("._")[:80]
    if safe == text:
        return safe
    return f"{safe}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
