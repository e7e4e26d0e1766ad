"""A suite's folder: what was begun in it, and which runs are done.

    suite.json               the suite as it was asked for; written first
    records/KEY.json         one for each run that is done, written whole after its folder
    runs/CASE/POINT/SYSTEM/SEED    each as `simbench run` leaves it
    results.csv timing.json report.html results.json    when all is done; the last is gone while
                             a suite is resumed, so that no gate takes it for what is asked now
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from simbench.errors import BadFile, UserError
from simbench.storage import TEMPORARY, write_bytes, write_json
from simbench.suites.jobs import Run, Task
from simbench.suites.spec import Suite
from simbench.suites.work import TaskResult, asked_of
from simbench.untrusted import read_json_object

SUITE, RECORDS, RESULTS = "suite.json", "records", "results.json"
SCHEMA = 1


class SuiteFolder:
    """Where a suite's runs are written, each once it is whole."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self._done: dict[str, dict[str, Any]] | None = None

    def claim(self, suite: Suite, runs: Iterable[Run], resume: bool) -> None:
        """Make the folder ours.

        Systems, seeds and cases may be added when a suite is resumed; what was done stays.

        Raises:
            UserError: the folder holds something else, or was begun with another suite, or holds
                one of the runs done otherwise.
        """
        if self.out.exists() and not self.out.is_dir():
            raise UserError(f"{self.out}: is a file, not a folder; choose another --out")
        if self.out.is_dir() and any(self.out.iterdir()) and not (resume and self._untouched()):
            if not resume:
                raise UserError(f"{self.out}: the folder is not empty; choose another --out, or "
                                "give --resume to finish a suite that was begun there")
            begun = read_json_object(self.out / SUITE, "no suite was begun here; choose another "
                                                       "--out")
            if begun.get("name") != suite.name or begun.get("version") != suite.version:
                raise UserError(f"{self.out}: suite {begun.get('name')!r} version "
                                f"{begun.get('version')!r} was begun here, not {suite.name!r} "
                                f"version {suite.version}; choose another --out")
            self.refuse_others(runs)
        (self.out / RESULTS).unlink(missing_ok=True)    # of what was asked for before
        (self.out / RECORDS).mkdir(parents=True, exist_ok=True)
        write_json(self.out / SUITE, {"schema": SCHEMA, **suite.as_json()})

    def _untouched(self) -> bool:
        """Whether all that is there is what a suite leaves that was killed before it had begun."""
        left = {path.name for path in self.out.iterdir()} - {SUITE + TEMPORARY}
        return left <= {RECORDS} and not any((self.out / RECORDS).glob("*"))

    def refuse_others(self, runs: Iterable[Run]) -> None:
        """A run's folder is that of its record, and is never written over by another's.

        Raises:
            UserError: what a run was done for in this folder is not what is asked for now.
        """
        if self._done is None:
            records = (_whole_record(path) for path in (self.out / RECORDS).glob("*.json"))
            self._done = {head["folder"]: head for record in records if record is not None
                          for head in [record["record"]]}
        for run in runs:
            done = self._done.get(run.folder)
            if done is not None and done["key"] != run.key:
                raise UserError(f"{self.out / run.folder}: was done {_otherwise(done, run)}; "
                                "choose another --out, or ask for what was asked for there")

    def record_of(self, run: Run) -> dict[str, Any] | None:
        """The record of a run that is done, or None. One that is broken, or whose folder is gone,
        counts as none."""
        found = _whole_record(self.out / RECORDS / f"{run.key}.json")
        return found if (self.out / run.folder).is_dir() else None

    def keep(self, task: Task, result: TaskResult) -> None:
        """Write the runs of a task: the files of each, then its record."""
        for run, each in zip(self._same(task, result), result.runs, strict=True):
            folder = self.out / run.folder
            if folder.exists():
                shutil.rmtree(folder)       # of a try that failed, or that was cut short
            folder.mkdir(parents=True)
            for name, data in each.files.items():
                write_bytes(folder / name, data)
            write_json(self.out / RECORDS / f"{run.key}.json",
                       {"record": each.record, "timing": each.timing, "meaning": result.meaning})

            if self._done is not None:
                self._done[run.folder] = each.record

    @staticmethod
    def _same(task: Task, result: TaskResult) -> Iterable[Run]:
        by_key = {run.key: run for run in task.runs}
        return [by_key[each.key] for each in result.runs]


def _whole_record(path: Path) -> dict[str, Any] | None:
    try:
        found = read_json_object(path, "run it again")
    except BadFile:
        return None
    head = found.get("record")
    if not isinstance(head, dict):
        return None
    texts = (head.get("key"), head.get("folder"))
    mappings = (found.get("timing"), found.get("meaning"), head.get("asked"),
                head.get("metrics", {}))
    whole = all(isinstance(each, str) for each in texts) \
        and all(isinstance(each, dict) for each in mappings)
    return found if whole else None


def _otherwise(done: dict[str, Any], run: Run) -> str:
    """How what was asked of a run that is done differs: "with frames 12, not 15"."""
    before, now = done["asked"], json.loads(json.dumps(asked_of(run)))
    for name in sorted(before.keys() | now.keys()):
        if before.get(name) != now.get(name):
            return f"with {name} {_shown(before.get(name))}, not {_shown(now.get(name))}"
    return "with other versions of the libraries, or on another folder of this name"


def _shown(value: Any) -> str:
    return "left out" if value is None else json.dumps(value)
