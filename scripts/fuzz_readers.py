"""Broken and hostile files: each is read, or refused in one line, within bounded memory.

    python scripts/fuzz_readers.py --inputs 100000

A small sequence is rendered and exported to every layout; then one file at a time is spoilt and its
reader called. A finding is any exception but UserError (numeric warnings count), an error that is
not one printable line of sensible length, or an input that makes the memory grow by 200 MB.
"""

from __future__ import annotations

import argparse
import json
import logging
import random
import resource
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simbench.baseline import SCHEMA, outcome_of, read_baseline
from simbench.datasets.calibration import read_calibration
from simbench.errors import UserError
from simbench.export import EXPORTERS
from simbench.external import read_camera, read_motions
from simbench.generate import GenerateSettings, generate
from simbench.ply import ply_text, read_ply
from simbench.run_folder import metrics_text, read_metrics
from simbench.run_source import read_source
from simbench.sequence import open_sequence
from simbench.storage import write_json
from simbench.suites.files import read_suite
from simbench.suites.folder import SuiteFolder
from simbench.suites.jobs import runs_of, tasks_of
from simbench.suites.spec import Case, Suite
from simbench.suites.work import RunResult, TaskResult, asked_of
from simbench.trajectory_files import kitti_lines, read_kitti_poses, tum_lines

MOST_GROWTH_MB = 200
MOST_CHARACTERS = 1500
_TOKENS = (b"1e309", b"nan", b"-1", b"0", b"1e300", b"99999999999999999999", b"-2147483649",
           b"4e9", b"0.5", b"../../../etc/passwd", b"/etc/passwd", b"[", b"{", b"]", b"}", b"\0",
           b"\xff\xfe", b"\xd9\xa3", b"&a [*a, *a]", b"!!python/object/apply:os.system [id]",
           b"2001-99-99", b"null", b"true", b'""', b"NaN", b"Infinity", b".inf", b"1.5",
           b":", b"#", b"\n\n", b" ", b"[" * 3000)


@dataclass(frozen=True)
class Target:
    """A file to spoil, and what reads it."""

    name: str
    path: Path
    read: Callable[[], object]


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(words)
    logging.disable(logging.WARNING)
    try:
        with tempfile.TemporaryDirectory() as folder:
            targets = make_targets(Path(folder))
            for target in targets:
                target.read()       # as it is, it is read
            return fuzz(targets, chosen.inputs, random.Random(chosen.seed))
    finally:
        logging.disable(logging.NOTSET)


def fuzz(targets: list[Target], inputs: int, chance: random.Random) -> int:
    """Spoil and read; print a table and every kind of finding. 1 if there was any."""
    counts: Counter[tuple[str, str]] = Counter()
    findings: Counter[str] = Counter()
    started, peak_mb = time.monotonic(), _peak_mb()
    for number in range(inputs):
        target = targets[number % len(targets)]
        whole = target.path.read_bytes()
        target.path.write_bytes(spoilt(whole, chance))
        try:
            outcome = _outcome(target.read)
        finally:
            target.path.write_bytes(whole)
        grown_mb, peak_mb = _peak_mb() - peak_mb, max(peak_mb, _peak_mb())
        if outcome in ("read", "refused"):
            counts[target.name, outcome] += 1
        else:
            findings[f"{target.name}: {outcome}"] += 1
        if grown_mb > MOST_GROWTH_MB:
            findings[f"{target.name}: memory grew by {grown_mb:.0f} MB"] += 1
    print("| file | read | refused |")
    print("|---|---|---|")
    for name in dict.fromkeys(target.name for target in targets):
        print(f"| {name} | {counts[name, 'read']} | {counts[name, 'refused']} |")
    print(f"{inputs} inputs, {sum(findings.values())} findings, "
          f"{time.monotonic() - started:.0f} s, peak memory {peak_mb:.0f} MB")
    for finding, times in findings.most_common():
        print(f"finding ({times} times): {finding}")
    return 1 if findings else 0


def _outcome(read: Callable[[], object]) -> str:
    """What came of reading a spoilt file: "read", "refused", or what must not be."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            read()
    except UserError as error:
        return "refused" if str(error).isprintable() and len(str(error)) <= MOST_CHARACTERS else \
            f"an error of {len(str(error))} characters: {str(error)[:80]!r}"
    except Exception as error:
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        where = "" if trace is None else (f" in {Path(trace.tb_frame.f_code.co_filename).name}:"
                                          f"{trace.tb_lineno}")
        return f"{type(error).__name__}{where}: {str(error)[:80]!r}"
    return "read"


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def spoilt(data: bytes, chance: random.Random) -> bytes:
    """The bytes with one to three things wrong."""
    out = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        chance.choice((_flip, _cut, _insert, _replace_word, _repeat, _header))(out, chance)
    return bytes(out)


def _flip(out: bytearray, chance: random.Random) -> None:
    if out:
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)


def _cut(out: bytearray, chance: random.Random) -> None:
    del out[chance.randrange(len(out) + 1):]


def _insert(out: bytearray, chance: random.Random) -> None:
    at = chance.randrange(len(out) + 1)
    out[at:at] = chance.choice(_TOKENS)


def _replace_word(out: bytearray, chance: random.Random) -> None:
    """Another token in place of what stands between two separators."""
    at = chance.randrange(len(out) + 1)
    ends = b" \n,:[]{}\"'"
    first, last = at, at
    while first > 0 and out[first - 1] not in ends and at - first < 40:
        first -= 1
    while last < len(out) and out[last] not in ends and last - at < 40:
        last += 1
    out[first:last] = chance.choice(_TOKENS)


def _repeat(out: bytearray, chance: random.Random) -> None:
    at = chance.randrange(len(out) + 1)
    out[at:at] = out[at:at + chance.randrange(1, 200)] * chance.choice((1, 2, 50))


def _header(out: bytearray, chance: random.Random) -> None:
    """A size of 32 bits near the beginning, as PNG, .flo and zstd have it; PNG's sum made right."""
    if len(out) < 40:
        return
    size = chance.choice((0, 1, 30_000, 2**31 - 1, 2**32 - 1))
    at = chance.choice((4, 5, 6, 8, 16, 20))
    out[at:at + 4] = size.to_bytes(4, chance.choice(("big", "little")))
    if out[12:16] == b"IHDR":
        out[29:33] = zlib.crc32(bytes(out[12:29])).to_bytes(4, "big")


def make_targets(folder: Path) -> list[Target]:
    """A rendered sequence in every layout, and the other files that are read."""
    generate(GenerateSettings.resolve("SwingingBoxes-v0", frames=2, size=(24, 16), stereo=True),
             folder / "simbench")
    rendered = open_sequence(folder / "simbench")
    for layout in ("tum", "vdo", "kitti"):
        EXPORTERS[layout](rendered, folder / layout, lambda: None)
    targets = []
    for layout in ("simbench", "tum", "vdo", "kitti"):
        place = folder / layout
        for path in sorted(p for p in place.rglob("*") if p.is_file()):
            name = path.relative_to(place).as_posix()
            read_by_nobody = name in ("associations.txt", "truth.zarr/zarr.json") \
                or name.startswith(("truth.zarr/state", "label_02")) \
                or (layout == "simbench" and name in ("rgb.txt", "depth.txt", "groundtruth.txt"))
            if not read_by_nobody:
                targets.append(Target(f"{layout} {_kind(name)}", path, _reading(place)))
    return targets + _other_targets(folder, rendered.truth.trajectories.T_world_camera)


def _kind(name: str) -> str:
    first, _, rest = name.partition("/")
    return name if not rest else f"{first}/…/zarr.json" if rest.endswith("zarr.json") else \
        f"{first}/…"


def _reading(place: Path) -> Callable[[], object]:
    def read() -> None:
        sequence = open_sequence(place)
        for k in range(min(len(sequence), 2)):
            sequence.frame(k)
            if sequence.truth is not None and sequence.truth.has_images:
                sequence.truth.frame(k)
        if sequence.truth is not None:
            sequence.truth.trajectories  # noqa: B018 (read when asked for)
    return read


def _other_targets(folder: Path, T: np.ndarray) -> list[Target]:
    stamps_s = np.arange(len(T)) / 10.0
    run = folder / "run"
    run.mkdir()
    metrics = {"system": "sdpl", "camera": {"E_t": 0.1, "E_R": 0.2, "coverage": 1.0},
               "sequence": {"name": "SwingingBoxes-v0", "frames": 2, "sha256": "0" * 64}}
    motion = "0.0 0.1 3 1 2 3 " + " ".join(map(str, np.eye(4).ravel())) + "\n"
    texts = {
        "run/metrics.json": metrics_text(metrics),
        "run/config.yaml": "source: SwingingBoxes-v0\nseed: 0\nframes: 2\nsize: [24, 16]\n"
                           "dials: {texture: 0.5}\n",
        "calibration.yaml": (folder / "tum/calibration.yaml").read_text() + "baseline_m: 0.1\n",
        "trajectory.txt": tum_lines(stamps_s, T), "poses.txt": kitti_lines(T),
        "object_motions.txt": motion * 2, "objects.txt": "0.0 3 1 2 3 0 0 0 1\n" * 2,
        "map.ply": ply_text(np.ones((3, 3)), np.ones((2, 2, 3))),
        "baseline.json": json.dumps({
            "schema": SCHEMA, "name": "x", "metrics": {"camera.E_t": {
                "unit": "m", "better": "lower", "relative": True, "tolerance": 0.02}},
            "runs": [{"case": "a", "point": {"texture": 1}, "system": "sdpl", "seed": 0,
                      "asked": {"scene": "x"}, "status": "done", "given_sha256": "0",
                      "values": {"camera.E_t": 0.1}}]}),
        "suite.yaml": "schema: 1\nname: mine\nversion: 1\nsystems: [sdpl]\nseeds: 0-2\n"
                      "defaults: {frames: 5, size: 64x48, flow: dis}\ncases:\n  a:\n"
                      "    scene: SwingingBoxes-v0\n    sweep: {texture: [1, 0.5]}\n"}
    for name, text in texts.items():
        (folder / name).write_text(text)
    camera, _ = read_camera(folder / "trajectory.txt", stamps_s)

    def at(name: str, read: Callable[[Path], object]) -> Target:
        return Target(name, folder / name, lambda: read(folder / name))

    suite = _finished_suite(folder / "suite")
    return [
        Target("suite/results.json", suite.out / "results.json", lambda: outcome_of(suite.out)),
        Target("suite/records/…", next(suite.out.glob("records/*")),
               lambda: SuiteFolder(suite.out).refuse_others(())),
        Target("run/metrics.json", run / "metrics.json",
               lambda: (read_metrics(run), outcome_of(run))),
        Target("run/config.yaml", run / "config.yaml", lambda: (outcome_of(run), read_source(run))),
        at("calibration.yaml", read_calibration),
        at("trajectory.txt", lambda path: read_camera(path, stamps_s)),
        at("poses.txt", read_kitti_poses),
        at("object_motions.txt", lambda path: read_motions(path, stamps_s, camera)),
        at("objects.txt", lambda path: read_motions(path, stamps_s, camera)),
        at("map.ply", read_ply), at("baseline.json", read_baseline),
        at("suite.yaml", read_suite)]


def _finished_suite(out: Path) -> SuiteFolder:
    """The folder of a suite of one run, with what is read of it again."""
    suite = Suite("mine", 1, "", (Case("a", "SwingingBoxes-v0", frames=2),), ("sdpl",), (0,),
                  ("camera.E_t",))
    run, = runs_of(suite)
    record = {"key": run.key, "case": run.case, "point": {}, "system": "sdpl", "seed": 0,
              "folder": run.folder, "asked": asked_of(run), "status": "done", "frames": 2,
              "lost_frames": 0, "sequence": {"given_sha256": "0" * 64},
              "metrics": {"camera.E_t": 0.1, "camera.coverage": 1.0}}
    folder = SuiteFolder(out)
    folder.claim(suite, (run,), resume=False)
    folder.keep(tasks_of([run])[0], TaskResult((RunResult(run.key, "done", "", False, record, {},
                                                          {}),), {}))
    write_json(out / "results.json", {"suite": suite.as_json(), "runs": [record]})
    return folder


if __name__ == "__main__":
    sys.exit(main())
