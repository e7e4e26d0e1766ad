"""How suites stand being killed, what they make of the processors, and whether a cluster agrees.

    python scripts/measure_suites.py [--parts busy kills dask] [--runs 100] [--kills 20]
        [--frames 12] [--workers 2] [--work DIR]

busy: a suite of `--runs` runs; the share of the time in which its workers ran or waited for a
processor that others held. kills: a small suite killed (SIGKILL, all of its processes) at random
moments and resumed, as often as is said; results.json, results.csv and all estimates must be those
of an undisturbed one. dask: the same small suite on a Dask cluster of two workers.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import psutil

SUITE = """
schema: 1
name: measured
description: Small pictures of boxes.
systems: [sdpl, vdo]
seeds: 0-{last}
metrics: [camera.E_t, objects.mean.E_t]
cases:
  boxes: {{scene: SwingingBoxes-v0, frames: {frames}, size: {size}, sensor: gaussian, flow: dis}}
"""
_COMMAND = "from simbench_command import main; raise SystemExit(main())"
_SAMPLE_S = 0.1
_KILL_RUNS = 16
_ESTIMATES = ("trajectory.txt", "object_motions.txt", "objects.txt")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=("busy", "kills", "dask"),
                        default=["busy", "kills", "dask"])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path)
    given = parser.parse_args(arguments)
    work = given.work or Path(tempfile.mkdtemp(prefix="simbench-suites-"))
    work.mkdir(parents=True, exist_ok=True)
    good = True
    if "busy" in given.parts:
        path = _write(work / "busy.yaml", given.runs, given.frames, "320x240")
        print(_busy(path, work / "busy", given.workers, given.runs), flush=True)
    if {"kills", "dask"} & set(given.parts):
        path = _write(work / "small.yaml", _KILL_RUNS, 4, "96x72")
        started = time.monotonic()
        _wait(_start(path, work / "whole", given.workers))
        whole_s = time.monotonic() - started
        wanted = _content(work / "whole")
        if "kills" in given.parts:
            good &= _kills(path, work, given.workers, given.kills, whole_s, wanted)
        if "dask" in given.parts:
            good &= _dask(path, work / "dask", wanted)
    return 0 if good else 1


def _write(path: Path, runs: int, frames: int, size: str) -> Path:
    path.write_text(SUITE.format(last=max(0, runs // 2 - 1), frames=frames, size=size))
    return path


def _start(suite: Path, out: Path, workers: int, *more: str) -> subprocess.Popen[bytes]:
    """The suite in a session of its own, so that all of it can be killed at once."""
    command = [sys.executable, "-c", _COMMAND, "suite", str(suite), "--out", str(out),
               "--reports", "none", *(more or ("--workers", str(workers)))]
    return subprocess.Popen([*command, *(["--resume"] if out.exists() else [])],
                            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                            start_new_session=True)


def _wait(process: subprocess.Popen[bytes]) -> None:
    _, told = process.communicate()
    if process.returncode:
        raise SystemExit(f"the suite failed: {told.decode().strip()}")


def _content(out: Path) -> dict[str, bytes]:
    """All bytes that are to be equal."""
    found = {name: (out / name).read_bytes() for name in ("results.json", "results.csv")}
    return found | {str(path.relative_to(out)): path.read_bytes()
                    for name in _ESTIMATES for path in sorted(out.glob(f"runs/**/{name}"))}


def _busy(suite: Path, out: Path, workers: int, runs: int) -> str:
    """What the workers' threads got of the processors, and what they waited for them."""
    process = _start(suite, out, workers)
    started = time.monotonic()
    spent: dict[tuple[int, int], tuple[float, float]] = {}
    while process.poll() is None:
        for pid in _workers_of(process.pid):
            spent |= _of_threads(pid)
        time.sleep(_SAMPLE_S)
    _wait(process)
    wall_s = time.monotonic() - started
    ran, waited = (sum(each) / (wall_s * workers) for each in zip(*spent.values(), strict=True))
    return (f"{runs} runs, {workers} workers, {wall_s:.0f} s: workers ran {100 * ran:.0f} % of the "
            f"time and waited {100 * waited:.0f} % for processors that others held, together "
            f"{100 * (ran + waited):.0f} %; starting and the page are in the time")


def _workers_of(pid: int) -> list[int]:
    try:
        return [child.pid for child in psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _of_threads(pid: int) -> dict[tuple[int, int], tuple[float, float]]:
    """(process, thread) to seconds on a processor and seconds ready to run; Linux alone tells."""
    found = {}
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        try:
            ran_ns, waited_ns, _ = path.read_text().split()
        except (OSError, ValueError):      # it ended meanwhile
            continue
        found[pid, int(path.parent.name)] = int(ran_ns) / 1e9, int(waited_ns) / 1e9
    return found


def _kills(suite: Path, work: Path, workers: int, kills: int, whole_s: float,
           wanted: dict[str, bytes]) -> bool:
    rng = np.random.default_rng(0)
    done, resumed, equal, ends, out = 0, 0, 0, 0, work / "killed"
    while done < kills or out.exists() or not ends:
        process = _start(suite, out, workers)
        killed = False
        if done < kills:
            try:
                process.wait(timeout=rng.uniform(0.0, whole_s))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                killed = True
        if killed:
            process.communicate()
            done += 1
            resumed += int(out.exists() and any(out.glob("records/*.json")))
            continue
        _wait(process)
        ends += 1
        equal += int(_content(out) == wanted)
        shutil.rmtree(out)
    print(f"killed {done} times, {resumed} of them with runs already done; {equal} of {ends} "
          f"suites ended with the bytes of the undisturbed one ({len(wanted)} files)", flush=True)
    return equal == ends


def _dask(suite: Path, out: Path, wanted: dict[str, bytes]) -> bool:
    from distributed import LocalCluster  # noqa: PLC0415 (an extra)

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        _wait(_start(suite, out, 2, "--dask", cluster.scheduler_address))
    equal = _content(out) == wanted
    print(f"on a Dask cluster of two workers: {'equal' if equal else 'DIFFERENT'} bytes",
          flush=True)
    return equal


if __name__ == "__main__":
    raise SystemExit(main())
