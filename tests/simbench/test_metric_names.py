"""Metrics by dotted names: what is kept of a metrics.json, and what a change for the worse is."""

import pytest

from simbench.errors import UnknownName
from simbench.metric_names import METRICS, find_metric, flat_metrics


def test_single_objects_become_means_over_all_that_move():
    flat = flat_metrics({"schema": 1, "timing": {"ms": 3.0}, "camera": {"E_t": 0.1, "rpe": {
        "1f": {"t_rmse": 0.2}}}, "objects": {
            "1": {"E_t": 1.0, "E_R": 2.0, "frames": 3, "moving_frames": 4},
            "2": {"E_t": 5.0, "E_R": 2.0, "E_t_rigid_fit": 2.0, "frames": 1, "moving_frames": 4},
            "3": {"coverage": 0.0, "frames": 0, "moving_frames": 2},
            "mean": {"E_t": 1.0, "coverage": 0.5}}})
    assert flat["camera.rpe.1f.t_rmse"] == 0.2
    assert flat["objects.mean.coverage"] == 0.5
    assert flat["objects.all.E_t"] == pytest.approx((3 * 1.0 + 5.0) / 4)
    assert flat["objects.all.E_t_rigid_fit"] == pytest.approx((3 * 1.0 + 2.0) / 4)
    assert flat["objects.all.coverage"] == pytest.approx(4 / 10)
    assert not [name for name in flat if name.startswith(("timing", "objects.1", "schema"))]


def test_worse_is_up_for_errors_and_down_for_coverage():
    assert METRICS["camera.E_t"].worsening(0.010, 0.011) == pytest.approx(0.1)
    assert METRICS["camera.E_t"].worsening(0.0, 1e-7) == pytest.approx(0.1)    # of the floor
    assert METRICS["camera.coverage"].worsening(1.0, 0.9) == pytest.approx(0.1)
    with pytest.raises(UnknownName, match=r"did you mean 'camera\.E_t'"):
        find_metric("camera.Et")
