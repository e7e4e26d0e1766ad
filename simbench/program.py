"""`command:"program {sequence} {out}"`: another program as a system."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import psutil

from simbench import run_folder
from simbench.errors import BadFile, UnknownName, UserError
from simbench.outcome import Outcome
from simbench.score_to_folder import score_to_folder
from simbench.sequence import Sequence

PREFIX = "command:"
_OBJECT_FILES = ("object_motions.txt", "objects.txt")
_LOOK_EVERY_S = 0.05
_KEPT_OUTPUT = 200_000    # bytes of what a program prints that go to the log: the last ones


@dataclass(frozen=True, slots=True)
class Limits:
    """What a program may take; None is no limit."""

    time_s: float | None = None
    memory_mb: float | None = None      # resident, of all its processes together


UNLIMITED = Limits()


@dataclass(frozen=True, slots=True)
class _Ended:
    """How a program ended."""

    fault: str               # "" where it ended well
    said: str
    seconds: float
    peak_mb: float


def run_program(system: str, sequence: Sequence, folder: Path, out: Path,
                limits: Limits = UNLIMITED) -> Outcome:
    """Let a program estimate, then score the files it wrote.

    `{sequence}` in its words becomes the sequence's folder and `{out}` a folder of its own,
    RUN/estimate, where it leaves `trajectory.txt` (TUM rows) and, where it estimates objects,
    `object_motions.txt` or `objects.txt`. What it prints goes to the log.

    A program that crashes, takes too much, or writes nothing that can be read has lost the run:
    the outcome says why, and every frame counts as lost.

    Raises:
        UnknownName: there is no such program.
        UserError: it is not named with {sequence} and {out}, or cannot be started.
    """
    words = words_of(system)
    estimate = out / "estimate"
    run_folder.prepare(out)
    estimate.mkdir(exist_ok=True)
    for name in ("trajectory.txt", *_OBJECT_FILES):
        (estimate / name).unlink(missing_ok=True)   # an earlier run's would be scored again
    words = [w.replace("{sequence}", str(folder)).replace("{out}", str(estimate)) for w in words]
    ended = _ended(words, system, limits, out / "output.txt")
    log = [f"{words[0]} took {ended.seconds:.1f} s", *ended.said.splitlines()]
    timing = {"program_s": ended.seconds, "peak_rss_mb": ended.peak_mb}
    if not ended.fault:
        try:
            return _scored(sequence, estimate, out, system, log, timing)
        except BadFile as error:
            return _lost(sequence, out, system, log, timing, f"wrote what cannot be read: {error}")
    return _lost(sequence, out, system, log, timing, ended.fault)


def _scored(sequence: Sequence, estimate: Path, out: Path, system: str, log: list[str],
            timing: Mapping[str, float]) -> Outcome:
    trajectory = estimate / "trajectory.txt"
    if not trajectory.is_file():
        raise BadFile(f"{trajectory}: no such file; the program must write TUM rows there")
    objects = next((estimate / n for n in _OBJECT_FILES if (estimate / n).is_file()), None)
    outcome = score_to_folder(sequence, trajectory, objects, out, system=system, log=log,
                              timing=timing)
    poses = outcome.frames - outcome.lost
    if poses < min(2, outcome.frames):
        return replace(outcome, failure=f"wrote a pose for {poses} of {outcome.frames} frames")
    return outcome


def _lost(sequence: Sequence, out: Path, system: str, log: list[str],
          timing: Mapping[str, float], reason: str) -> Outcome:
    outcome = score_to_folder(sequence, None, None, out, system=system,
                              log=[f"lost: {reason}", *log], timing=timing)
    return replace(outcome, failure=reason)


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


def _ended(words: list[str], system: str, limits: Limits, output: Path) -> _Ended:
    """Start a program in a session of its own, watch it, and end all of it at a limit."""
    started = time.monotonic()
    with output.open("wb") as stream:
        try:
            process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=stream,
                                       stderr=subprocess.STDOUT, start_new_session=True)
        except OSError as error:   # it is there and may be executed
            raise UserError(f"--system {system}: {words[0]!r} cannot be started "
                            f"({error.strerror}); check its first line, as in #!/bin/sh") from None
        try:
            fault, peak_mb = _watched(process, limits, started)
        finally:
            _end(process)
    seconds = time.monotonic() - started
    said = _end_of(output).decode(errors="replace")
    output.unlink()
    if not fault and process.returncode:
        last = (said.strip().splitlines() or ["it printed nothing"])[-1]
        fault = f"{_ending(process.returncode)}: {last}"
    return _Ended(fault, said, seconds, peak_mb)


def _end_of(output: Path) -> bytes:
    """The last bytes of a file."""
    with output.open("rb") as stream:
        stream.seek(max(0, output.stat().st_size - _KEPT_OUTPUT))
        return stream.read(_KEPT_OUTPUT)


def _watched(process: subprocess.Popen[bytes], limits: Limits, started: float
             ) -> tuple[str, float]:
    """Wait for the end. Returns which limit was passed, if any, and the most memory seen in MB."""
    peak_mb = 0.0
    while True:
        peak_mb = max(peak_mb, _memory_mb(process.pid))
        if limits.memory_mb is not None and peak_mb > limits.memory_mb:
            return f"held {peak_mb:.0f} MB, {limits.memory_mb:g} are allowed", peak_mb
        if limits.time_s is not None and time.monotonic() - started > limits.time_s:
            return f"took longer than the {limits.time_s:g} s that are allowed", peak_mb
        try:
            process.wait(_LOOK_EVERY_S)
        except subprocess.TimeoutExpired:
            continue
        return "", peak_mb


def _memory_mb(pid: int) -> float:
    """Resident memory of a process and all below it; 0 once it has gone."""
    total = 0
    with contextlib.suppress(psutil.Error):
        root = psutil.Process(pid)
        for each in (root, *root.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                total += each.memory_info().rss
    return total / 1e6


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the program, and what it started and left behind."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _ending(code: int) -> str:
    if code > 0:
        return f"ended with {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
