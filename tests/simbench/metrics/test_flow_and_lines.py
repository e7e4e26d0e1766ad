"""Flow end-point errors, NEES, timing."""

from __future__ import annotations

import numpy as np
import pytest

from simbench.metrics.consistency import nees
from simbench.metrics.flow import FlowErrors, end_point_errors
from simbench.metrics.timing import timing_metrics
from simbench.types import FlowTruth
from slam.geometry import se3
from slam.types import FlowField, Frame, FrameEstimate
from synthetic import CAMERA

NONE = np.zeros((48, 64), bool)


class Truth:
    def flow(self, i: int, j: int) -> FlowTruth:
        occluded, leaving = NONE.copy(), NONE.copy()
        occluded[:, :4], leaving[:, -4:] = True, True
        return FlowTruth(np.full((48, 64, 2), 2.0, np.float32),
                         np.zeros((48, 64, 3), np.float32), ~NONE, occluded, leaving, NONE)


def field(**changes) -> FlowField:
    flow = np.full((48, 64, 2), (2.3, 2.4), np.float32)
    flow[:, :4] = flow[:, -4:] = 99.0     # hidden and leaving pixels do not count
    return FlowField(flow, **changes)


def test_the_end_point_error_is_that_of_pixels_seen_in_both_frames():
    errors = end_point_errors(field(), Truth().flow(0, 1))
    assert len(errors) == 48 * 56
    np.testing.assert_allclose(errors, 0.5, atol=1e-6)
    assert len(end_point_errors(field(valid=NONE), Truth().flow(0, 1))) == 0


def test_the_mean_is_over_all_pixels_of_all_frames_that_bring_flow():
    measure = FlowErrors(Truth())
    image, depth = np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32)
    for k, flow in enumerate((None, field(), None, field())):
        measure(Frame(k, 0.1 * k, image, depth, CAMERA, flow=flow),
                FrameEstimate(k, 0.1 * k, np.eye(4), np.eye(4)))
    assert measure.metrics() == {"epe": pytest.approx(0.5, abs=1e-6)}
    assert FlowErrors(None).metrics() == {}


def test_nees_is_six_where_the_covariance_is_right():
    rng = np.random.default_rng(0)
    root = 0.01 * rng.normal(size=(6, 6))
    covariance = np.repeat((root @ root.T)[None], 4000, 0)
    T = se3.exp(rng.normal(size=(4000, 6)))
    true = T @ se3.exp(rng.normal(size=(4000, 6)) @ root.T)
    assert nees(T, true, covariance).mean() == pytest.approx(6.0, rel=0.05)
    assert nees(T, true, 4.0 * covariance).mean() == pytest.approx(1.5, rel=0.05)


def test_the_first_frame_stands_apart_and_stages_are_averaged_over_those_that_name_them():
    out = timing_metrics(np.array([900.0, 10.0, 20.0, 60.0]),
                         [{"a": 700.0}, {"a": 1.0}, {"a": 3.0, "b": 5.0}, {}], None)
    assert out["ms_first_frame"] == 900.0
    assert out["ms_per_frame_mean"] == 30.0
    assert out["ms_per_frame_median"] == 20.0
    assert out["ms_per_frame_p95"] == pytest.approx(56.0)
    assert out["stages_ms"] == {"a": 2.0, "b": 5.0}
    assert "batch_global_s" not in out
    assert timing_metrics(np.array([900.0]), [{"a": 700.0}], None) == {"ms_first_frame": 900.0}
    assert timing_metrics(np.zeros(0), [], None) == {}
