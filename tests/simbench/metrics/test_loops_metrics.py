"""Closed loops: how many, where, and whether the truth says so, too."""

import numpy as np
import pytest

from simbench.metrics.loops import loop_metrics
from simbench.types import Trajectories
from slam.geometry import se3
from slam.types import ClosedLoops, SlamResult, Status

K = 20
STAMPS = 0.1 * np.arange(K)
TRUE = se3.exp(np.random.default_rng(0).normal(0.0, 0.7, (K, 6)))


def truth(valid: np.ndarray | None = None) -> Trajectories:
    return Trajectories(STAMPS, TRUE, np.ones(K, bool) if valid is None else valid, {})


def result(rows: np.ndarray, loops: ClosedLoops | None) -> SlamResult:
    """Of the frames `rows` of the sequence alone."""
    return SlamResult(STAMPS[rows], TRUE[rows], {}, (Status.TRACKED,) * len(rows), loops=loops)


def claimed(now: int, before: int, off: list[float]) -> np.ndarray:
    return se3.inverse(TRUE[before]) @ TRUE[now] @ se3.exp(np.array(off))


def test_a_loop_is_false_by_half_a_metre_or_five_degrees():
    turn = np.radians(6.0)
    T = np.stack([claimed(15, 2, [0, 0, 0, 0.3, 0, 0.3]), claimed(16, 3, [0, turn, 0, 0, 0, 0]),
                  claimed(17, 4, [0, 0, 0, 0.4, 0, 0.4])])
    loops = ClosedLoops(np.array([15, 16, 17]), np.array([2, 3, 4]), T)
    found = loop_metrics(result(np.arange(K), loops), STAMPS, truth())
    assert (found["closed"], found["false"]) == (3, 2)
    assert [(x["frame"], x["seen_before"]) for x in found["at"]] == [(15, 2), (16, 3), (17, 4)]
    assert found["at"][0]["error_m"] == pytest.approx(np.hypot(0.3, 0.3))
    assert found["at"][1]["error_deg"] == pytest.approx(6.0)
    assert found["at"][2]["position_m"] == pytest.approx(TRUE[17, :3, 3].tolist())


def test_rows_of_a_run_that_missed_frames_are_told_as_frames():
    rows = np.arange(5, K)
    loops = ClosedLoops(np.array([10]), np.array([1]), claimed(15, 6, [0] * 6)[None])
    found = loop_metrics(result(rows, loops), STAMPS, truth())
    assert (found["at"][0]["frame"], found["at"][0]["seen_before"]) == (15, 6)
    assert found["false"] == 0


def test_where_no_truth_is_known_no_loop_is_judged():
    valid = np.ones(K, bool)
    valid[2] = False
    T = claimed(15, 2, [0, 0, 0, 9.0, 0, 0])[None]
    loops = ClosedLoops(np.array([15]), np.array([2]), T)
    found = loop_metrics(result(np.arange(K), loops), STAMPS, truth(valid))
    assert found["false"] == 0
    assert "error_m" not in found["at"][0]
    assert "false" not in loop_metrics(result(np.arange(K), loops), STAMPS, None)


def test_no_loops_are_a_count_of_0_and_a_system_that_looks_for_none_has_no_block():
    none = ClosedLoops(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    assert loop_metrics(result(np.arange(K), none), STAMPS, truth()) == {
        "closed": 0, "at": [], "false": 0}
    assert loop_metrics(result(np.arange(K), None), STAMPS, truth()) == {}
