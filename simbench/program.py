"""`command:"program {sequence} {out}"`: another program as a system."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import time
from pathlib import Path

from simbench import run_folder
from simbench.errors import BadFile, UnknownName, UserError
from simbench.run_to_folder import Outcome, score_to_folder
from simbench.sequence import Sequence

PREFIX = "command:"
_OBJECT_FILES = ("object_motions.txt", "objects.txt")


def run_program(system: str, sequence: Sequence, folder: Path, out: Path) -> Outcome:
    """Let a program estimate, then score the files it wrote.

    `{sequence}` in its words becomes the sequence's folder and `{out}` a folder of its own,
    RUN/estimate, where it leaves `trajectory.txt` (TUM rows) and, where it estimates objects,
    `object_motions.txt` or `objects.txt`. What it prints goes to the log.

    Raises:
        UnknownName: there is no such program.
        UserError: it is not named with {sequence} and {out}, or ends with an error.
        BadFile: it wrote no trajectory, or a broken one.
    """
    words = words_of(system)
    estimate = out / "estimate"
    run_folder.prepare(out)
    estimate.mkdir(exist_ok=True)
    for name in ("trajectory.txt", *_OBJECT_FILES):
        (estimate / name).unlink(missing_ok=True)   # an earlier run's would be scored again
    words = [w.replace("{sequence}", str(folder)).replace("{out}", str(estimate)) for w in words]
    started = time.perf_counter()
    said = _output_of(words, system)
    seconds = time.perf_counter() - started
    trajectory = estimate / "trajectory.txt"
    if not trajectory.is_file():
        raise BadFile(f"{trajectory}: {words[0]} wrote no trajectory there; it must write TUM rows")
    objects = next((estimate / n for n in _OBJECT_FILES if (estimate / n).is_file()), None)
    log = [f"{words[0]} took {seconds:.1f} s", *said.splitlines()]
    return score_to_folder(sequence, trajectory, objects, out, system=system, log=log)


def words_of(system: str) -> list[str]:
    """The program and its arguments, with {sequence} and {out} in them.

    Raises:
        UnknownName: there is no such program.
        UserError: {sequence} or {out} is missing, quotes are open, or it may not be executed.
    """
    template = system.removeprefix(PREFIX)
    if "{sequence}" not in template or "{out}" not in template:
        raise UserError(f"--system {system}: wanted command:\"program {{sequence}} {{out}}\"")
    try:
        words = shlex.split(template)
        if len(words) == 1:   # quoted as a whole, for a shell that took its own quotes away
            words = shlex.split(words[0])
    except ValueError as error:
        raise UserError(f"--system {system}: {error}; mend the quotes") from None
    if shutil.which(words[0]) is None:
        if Path(words[0]).is_file():
            raise UserError(f"--system {system}: {words[0]!r} may not be executed; chmod +x it")
        raise UnknownName(f"--system {system}: no program {words[0]!r}; give its path")
    return words


def _output_of(words: list[str], system: str) -> str:
    try:
        done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                              errors="replace", check=False)
    except OSError as error:   # it is there and may be executed
        raise UserError(f"--system {system}: {words[0]!r} cannot be started ({error.strerror}); "
                        "check its first line, as in #!/bin/sh") from None
    if done.returncode != 0:
        last = done.stdout.strip().splitlines()[-1:] or ["it printed nothing"]
        raise UserError(f"--system {system}: {words[0]} ended with {done.returncode}: {last[0]}")
    return done.stdout
