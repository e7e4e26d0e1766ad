"""Equal input gives equal bytes: in two runs, in two processes, with one thread or two."""

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import box_world as bw
import slam
from slam.systems import sdpl

TESTS = Path(__file__).resolve().parents[2]


def digest(frames, name="sdpl") -> str:
    """SHA-256 of all that a run estimates and of the features it shows."""
    system = slam.make(name, frames[0].intrinsics)
    found = hashlib.sha256()
    for frame in frames:
        e = system.process(frame)
        parts = [e.T_world_camera, e.T_previous_camera, e.points.uv_px, e.points.track_id,
                 e.segments.endpoints_px, e.segments.depth_m]
        parts += [m.H_world for m in e.objects.values()]
        parts += [P for P in (e.covariance, *(m.covariance for m in e.objects.values()))
                  if P is not None]
        for part in parts:
            found.update(np.ascontiguousarray(part).tobytes())
    result = system.finish()
    for part in (result.T_world_camera, *(t.H_world for t in result.objects.values())):
        found.update(np.ascontiguousarray(part).tobytes())
    return found.hexdigest()


def small_sequence(with_flow):
    camera = bw.hand_held(4)
    box = {3: bw.Box((0.45, 0.35, 0.4), bw.moving(-0.5, 0.1, 0.2, 4, (0.05, 0.0, 0.02)))}
    return bw.sequence(camera, box, with_flow=with_flow)


def test_two_runs_give_equal_bytes(two_boxes):
    frames = two_boxes[2]
    for given in (frames, [replace(f, flow=None) for f in frames]):
        assert digest(given) == digest(given)


def test_processes_with_one_thread_and_with_two_give_equal_bytes():
    program = (f"import sys; sys.path[:0] = [{str(TESTS)!r}, {str(Path(__file__).parent)!r}]\n"
               "from test_determinism import digest, small_sequence\n"
               "print(digest(small_sequence(False)), digest(small_sequence(True)),\n"
               "      digest(small_sequence(False), 'sdpl-paper-batch'))")
    running = [subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True,
        env=os.environ | {f"{library}_NUM_THREADS": threads
                          for library in ("OPENBLAS", "OMP", "NUMBA")})
        for threads in ("1", "2")]
    answers = [process.communicate()[0].split() for process in running]
    assert [process.returncode for process in running] == [0, 0]
    assert answers[0] == answers[1] == [digest(small_sequence(False)),
                                        digest(small_sequence(True)),
                                        digest(small_sequence(False), "sdpl-paper-batch")]


def test_a_failure_beside_tracking_is_raised(two_boxes, monkeypatch):
    """Detection runs on a thread of its own; what goes wrong there must not be lost."""
    frames = two_boxes[2]
    system = slam.make("sdpl", frames[0].intrinsics)
    system.process(frames[0])

    def broken(current, config):
        raise MemoryError("no room for the picture")

    monkeypatch.setattr(sdpl, "detect", broken)
    with pytest.raises(MemoryError, match="no room"):
        system.process(frames[1])
