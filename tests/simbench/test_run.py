"""The run loop, its scores and its folder, with systems that were told the truth."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from simbench.errors import BadFile, UserError
from simbench.metrics.motion import motion_errors
from simbench.run import evaluate, run, score
from simbench.run_folder import metrics_text, read_metrics, write_run
from simbench.score import Online
from slam.geometry import se3
from slam.types import Frame, FrameEstimate, SlamResult, Status
from synthetic import PerturbedTruth, SyntheticFeed, SyntheticSequence, world

TRUTH = world()
P_CAMERA = se3.exp(np.array([0.001, -0.002, 0.0005, 0.003, 0.001, -0.002]))
P_OBJECT = se3.exp(np.array([0.0, 0.01, 0.002, -0.004, 0.002, 0.01]))


def scored(system: object, broken: tuple[int, ...] = ()) -> tuple:
    record = run(system, SyntheticFeed(SyntheticSequence(TRUTH, broken)))
    return record, score(TRUTH, record)


def all_numbers(block: object) -> list[float]:
    if isinstance(block, dict):
        return [x for value in block.values() for x in all_numbers(value)]
    return [block] if isinstance(block, float) else []


def test_the_truth_scores_zero_and_full_coverage():
    record, metrics = scored(PerturbedTruth(TRUTH))
    assert not record.log
    assert metrics["camera"]["E_t"] < 1e-12
    assert metrics["camera"]["rpe"]["1f"]["r_rmse_deg"] < 1e-10
    for key in ("1", "2", "mean"):
        assert metrics["objects"][key]["E_t"] < 1e-10
        assert metrics["objects"][key]["coverage"] == 1.0
    assert metrics["objects"]["mean"]["id_switches"] == 0
    assert metrics["lines"] == {"static_tracklet_length": 4.0}


def test_known_errors_are_found_online_and_in_the_batch():
    _, metrics = scored(PerturbedTruth(TRUTH, P_CAMERA, P_OBJECT))
    t, r = motion_errors(np.eye(4), P_CAMERA)
    for block in ("camera", "camera_batch"):
        assert metrics[block]["E_t"] == pytest.approx(t, rel=1e-6)
        assert metrics[block]["E_R"] == pytest.approx(r, rel=1e-6)
    t, r = motion_errors(np.eye(4), P_OBJECT)
    for block in ("objects", "objects_batch"):
        assert metrics[block]["mean"]["E_t_local"] == pytest.approx(t, rel=1e-6)
        assert metrics[block]["mean"]["E_R_local"] == pytest.approx(r, rel=1e-6)


def test_the_keys_are_those_promised_and_nothing_is_nan():
    _, metrics = scored(PerturbedTruth(TRUTH, P_CAMERA, P_OBJECT))
    assert set(metrics) == {"camera", "objects", "camera_batch", "objects_batch", "lines",
                            "timing"}
    for name in ("camera", "camera_batch"):
        camera = metrics[name]
        assert set(camera) == {"E_t", "E_R", "coverage", "ate", "rpe"}
        assert {"rmse", "mean", "median", "std"} <= set(camera["ate"])
        assert set(camera["rpe"]) == {"1f", "10f", "1s"}
        for rpe in camera["rpe"].values():
            assert {"t_rmse", "t_mean", "t_std", "r_rmse_deg", "r_mean_deg", "r_std_deg",
                    "r_rmse_rad"} <= set(rpe)
    for key in ("1", "2"):
        assert {"E_t", "E_R", "E_t_local", "E_R_local", "rigid", "frames", "coverage"} \
            <= set(metrics["objects"][key])
    assert {"E_t", "E_R", "coverage", "id_switches"} <= set(metrics["objects"]["mean"])
    timing = metrics["timing"]
    assert set(timing) == {"ms_first_frame", "ms_per_frame_mean", "ms_per_frame_median",
                           "ms_per_frame_p95", "stages_ms", "batch_global_s", "peak_rss_mb"}
    assert timing["stages_ms"] == {"flow": 4.0, "camera": 2.0}
    assert timing["peak_rss_mb"] > 10
    assert np.all(np.isfinite(all_numbers(metrics)))
    assert json.loads(metrics_text(metrics))["schema"] == 1


def test_a_track_that_changes_its_number_is_a_switch_and_no_loss():
    half = PerturbedTruth(TRUTH, tracks=lambda k: {1: 7 if k < 20 else 8, 2: 3})
    _, metrics = scored(half)
    assert metrics["objects"]["mean"]["id_switches"] == 1
    assert metrics["objects"]["1"]["coverage"] == 1.0
    assert metrics["objects_batch"]["mean"]["id_switches"] == 1


def test_an_object_never_estimated_stays_in_the_table_with_coverage_zero():
    _, metrics = scored(PerturbedTruth(TRUTH, tracks=lambda k: {1: 7}))
    assert metrics["objects"]["2"]["coverage"] == 0.0
    assert "E_t" not in metrics["objects"]["2"]
    assert metrics["objects"]["mean"]["coverage"] == 0.5


def test_unreadable_frames_are_lost_with_their_reason_and_the_run_goes_on():
    record, metrics = scored(PerturbedTruth(TRUTH), broken=(5, 6, 20))
    assert [k for k, lost in enumerate(record.lost) if lost] == [5, 6, 20]
    assert record.estimates[5].reason == "rgb/5.png: truncated; replace it"
    assert record.log[0].startswith("frame 5: lost: rgb/5.png")
    # Motions into 5, 6, 7 and 20, 21 are missing or span several frames.
    assert metrics["camera"]["coverage"] == pytest.approx(34 / 39)
    assert metrics["camera"]["E_t"] < 1e-12
    assert metrics["objects"]["1"]["coverage"] == pytest.approx(34 / 39)
    assert metrics["camera_batch"]["coverage"] == pytest.approx(34 / 39)


class Faulty(PerturbedTruth):
    """Raises on frame 4, returns NaN on 8, None on 12, and a broken object on 16."""

    def process(self, frame: Frame) -> FrameEstimate:
        estimate = super().process(frame)
        if frame.index == 4:
            raise ZeroDivisionError("inliers")
        if frame.index == 8:
            return FrameEstimate(8, frame.stamp_s, np.full((4, 4), np.nan), np.eye(4))
        if frame.index == 12:
            return None  # type: ignore[return-value]
        if frame.index == 16:
            object.__setattr__(estimate.objects[7], "H_world", np.full((4, 4), np.inf))
        return estimate


def test_a_system_that_fails_loses_those_frames_and_the_log_tells_it():
    record, metrics = scored(Faulty(TRUTH))
    assert [k for k, lost in enumerate(record.lost) if lost] == [4, 8, 12]
    assert "the system raised ZeroDivisionError: inliers" in record.estimates[4].reason
    assert any("Traceback" in entry for entry in record.log)
    assert "frame 16: track 7 left out: no rigid motion" in record.log
    assert metrics["camera"]["coverage"] == pytest.approx(33 / 39)
    assert metrics["objects"]["1"]["coverage"] == pytest.approx(32 / 39)
    assert metrics["objects"]["2"]["coverage"] == pytest.approx(33 / 39)


class Refusing(PerturbedTruth):
    def process(self, frame: Frame) -> FrameEstimate:
        raise UserError("this system needs a right image")


def test_a_system_that_refuses_its_input_ends_the_run():
    with pytest.raises(UserError, match="right image"):
        scored(Refusing(TRUTH))


class Unfinished(PerturbedTruth):
    def finish(self) -> SlamResult:
        raise RuntimeError("no memory")


def test_a_failed_finish_leaves_the_online_scores():
    record, metrics = scored(Unfinished(TRUTH))
    assert "camera_batch" not in metrics
    assert metrics["camera"]["coverage"] == 1.0
    assert any("no memory" in entry for entry in record.log)


class Lost(PerturbedTruth):
    def process(self, frame: Frame) -> FrameEstimate:
        return FrameEstimate(frame.index, frame.stamp_s, np.eye(4), np.eye(4),
                             status=Status.LOST, reason="no features")


class Handless(PerturbedTruth):
    """Forgets to return anything."""

    def process(self, frame: Frame) -> FrameEstimate:
        return None  # type: ignore[return-value]

    def finish(self) -> SlamResult:
        return None  # type: ignore[return-value]


def test_a_system_that_fails_on_every_frame_loses_the_run():
    record, _ = scored(Handless(TRUTH), broken=(0,))
    assert record.failure == ("lost every frame (frame 1: the system returned NoneType, wanted "
                              "FrameEstimate)")
    assert record.unreadable == {0: "rgb/0.png: truncated; replace it"}
    assert record.finish_fault == "finish: the system returned NoneType, wanted SlamResult"
    assert scored(Faulty(TRUTH))[0].failure == ""


class LostAfter(PerturbedTruth):
    """Tracks as many frames as `tracked` says, then none."""

    tracked = 1

    def process(self, frame: Frame) -> FrameEstimate:
        estimate = super().process(frame)
        if frame.index < self.tracked:
            return estimate
        return replace(estimate, status=Status.LOST, reason="too dark")


def test_a_run_is_lost_where_no_frame_after_the_first_is_followed():
    assert scored(Lost(TRUTH))[0].failure == "lost every frame (frame 0: no features)"
    assert scored(LostAfter(TRUTH))[0].failure \
        == "lost every frame after the first (frame 1: too dark)"
    followed = LostAfter(TRUTH)
    followed.tracked = 2
    assert scored(followed)[0].failure == ""


def test_frames_that_cannot_be_read_lose_no_run():
    frames = range(len(TRUTH.stamps_s))
    assert scored(PerturbedTruth(TRUTH), broken=tuple(frames))[0].failure == ""
    assert scored(PerturbedTruth(TRUTH), broken=tuple(frames)[1:])[0].failure == ""
    assert scored(Lost(TRUTH), broken=tuple(frames)[1:])[0].failure \
        == "lost every frame (frame 0: no features)"


def test_a_system_that_never_tracks_has_coverage_zero_and_no_errors():
    record, metrics = scored(Lost(TRUTH))
    assert metrics["camera"] == {"coverage": 0.0}
    assert metrics["objects"]["1"]["coverage"] == 0.0
    assert len(record.log) == len(TRUTH.stamps_s) + 1   # and finish knows of no frames


def test_without_truth_there_are_timings_and_no_errors():
    record, _ = scored(PerturbedTruth(TRUTH))
    assert set(score(None, record)) == {"lines", "timing"}


def test_evaluate_scores_a_result_by_the_nearest_objects():
    sequence = SyntheticSequence(TRUTH)
    system = PerturbedTruth(TRUTH, P_CAMERA, P_OBJECT)
    record = run(system, SyntheticFeed(sequence))
    report = evaluate(sequence, record.result)
    t, r = motion_errors(np.eye(4), P_OBJECT)
    assert report["objects"]["mean"]["E_t_local"] == pytest.approx(t, rel=1e-6)
    assert report["objects"]["mean"]["E_R_local"] == pytest.approx(r, rel=1e-6)
    assert report["camera"]["E_t"] == pytest.approx(motion_errors(np.eye(4), P_CAMERA)[0],
                                                    rel=1e-6)
    other = SyntheticSequence(world(count=10))
    with pytest.raises(UserError, match="not a result of this sequence"):
        evaluate(other, record.result)


def test_the_folder_holds_what_is_promised(tmp_path):
    record, metrics = scored(PerturbedTruth(TRUTH, P_CAMERA, P_OBJECT))
    online = Online.of(record)
    write_run(tmp_path, metrics=metrics, stamps_s=record.stamps_s, camera=online.camera,
              motions=online.motions, report_html="<p>report</p>",
              config={"settings": {"a": 1}, "system": "x"}, log=["one", "two\nlines"])
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "config.yaml", "log.txt", "metrics.json", "object_motions.txt", "objects.txt",
        "report.html", "trajectory.txt"]
    assert read_metrics(tmp_path)["camera"] == metrics["camera"]
    assert yaml.safe_load((tmp_path / "config.yaml").read_text()) == {
        "settings": {"a": 1}, "system": "x"}
    rows = (tmp_path / "object_motions.txt").read_text().splitlines()
    assert len(rows) == 2 * 39
    assert all(len(row.split()) == 22 for row in rows)
    assert re.fullmatch(r"0\.000000 0\.100000 3( -?[\d.e-]+){19}", rows[0])


def test_reading_a_folder_without_a_run_says_so(tmp_path):
    with pytest.raises(BadFile, match="no such file"):
        read_metrics(tmp_path)
    (tmp_path / "metrics.json").write_text('{"schema": 1,')
    with pytest.raises(BadFile, match=r"metrics.json:1: not valid JSON"):
        read_metrics(tmp_path)
    (tmp_path / "metrics.json").write_text('{"schema": 99}')
    with pytest.raises(BadFile, match="schema"):
        read_metrics(tmp_path)


def test_metrics_with_nan_are_never_written():
    with pytest.raises(ValueError, match="JSON"):
        metrics_text({"camera": {"E_t": float("nan")}})
