"""Scoring the files of another program, and our own files read back."""

from __future__ import annotations

import numpy as np
import pytest

from simbench.errors import BadFile, UserError
from simbench.external import read_camera, read_motions
from simbench.run import run, score
from simbench.run_folder import motion_lines, pose_lines, read_metrics
from simbench.score import Online
from simbench.score_to_folder import score_to_folder
from simbench.trajectory_files import tum_lines
from slam.geometry import se3
from synthetic import PerturbedTruth, SyntheticFeed, SyntheticSequence, world

TRUTH = world()
P_CAMERA = se3.exp(np.array([0.001, -0.002, 0.0005, 0.003, 0.001, -0.002]))
P_OBJECT = se3.exp(np.array([0.0, 0.01, 0.002, -0.004, 0.002, 0.01]))


@pytest.fixture
def written(tmp_path):
    record = run(PerturbedTruth(TRUTH, P_CAMERA, P_OBJECT),
                 SyntheticFeed(SyntheticSequence(TRUTH)))
    online = Online.of(record)
    texts = {"trajectory.txt": tum_lines(record.stamps_s, online.camera.T_world_camera),
             "object_motions.txt": motion_lines(online.motions, record.stamps_s),
             "objects.txt": pose_lines(online.motions, record.stamps_s)}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    return tmp_path, score(TRUTH, record)


@pytest.mark.parametrize("name", ["object_motions.txt", "objects.txt"])
def test_our_own_files_score_as_the_run_did(written, name):
    folder, metrics = written
    outcome = score_to_folder(SyntheticSequence(TRUTH), folder / "trajectory.txt", folder / name,
                              folder / "scored")
    again = read_metrics(folder / "scored")
    assert not outcome.log
    for key in ("E_t", "E_R", "coverage"):
        assert again["camera"][key] == pytest.approx(metrics["camera"][key], rel=1e-7)
    assert again["camera"]["ate"]["rmse"] == pytest.approx(metrics["camera"]["ate"]["rmse"])
    for key in ("1", "2", "mean"):
        for value in ("E_t", "E_R", "E_t_local", "E_R_local", "coverage", "frames"):
            assert again["objects"][key][value] == pytest.approx(metrics["objects"][key][value],
                                                                 rel=1e-6)
    assert (folder / "scored" / "report.html").is_file()


def test_without_an_objects_file_no_object_is_said_to_be_missed(written):
    folder, _ = written
    outcome = score_to_folder(SyntheticSequence(TRUTH), folder / "trajectory.txt", None,
                              folder / "scored")
    assert "objects" not in outcome.metrics
    assert outcome.metrics["camera"]["coverage"] == 1.0


def test_another_world_and_half_the_rows_give_the_same_errors_and_half_the_coverage(written):
    folder, metrics = written
    stamps = TRUTH.stamps_s
    camera, _ = read_camera(folder / "trajectory.txt", stamps)
    A = se3.exp(np.array([1.0, -0.5, 2.0, 30.0, -4.0, 7.0]))
    (folder / "half.txt").write_text("# t tx ty tz qx qy qz qw\n" + tum_lines(
        stamps[:20] + 0.004, A @ camera.T_world_camera[:20]))
    outcome = score_to_folder(SyntheticSequence(TRUTH), folder / "half.txt", None,
                              folder / "scored")
    assert outcome.metrics["camera"]["E_t"] == pytest.approx(metrics["camera"]["E_t"], rel=1e-6)
    assert outcome.metrics["camera"]["coverage"] == pytest.approx(19 / 39)
    assert outcome.lost == 20


@pytest.mark.parametrize(("rows", "line", "fault"), [
    ("0.0 0 0 0 0 0 0 1\n0.1 0 0 zero 0 0 0 1\n", 2, "numbers"),
    ("# fine\n\n0.0 0 0 0 0 0 1\n", 3, "7 columns"),
    ("0.0 0 0 nan 0 0 0 1\n", 1, "finite")])
def test_a_broken_pose_is_named_by_file_and_line(tmp_path, rows, line, fault):
    path = tmp_path / "estimate.txt"
    path.write_text(rows)
    with pytest.raises(BadFile, match=rf"estimate\.txt:{line}: .*{fault}"):
        read_camera(path, TRUTH.stamps_s)


@pytest.mark.parametrize(("row", "fault"), [
    ("0.0 0.1 3 0 0 0 2 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "not a rigid motion"),
    ("0.0 0.1 3.5 0 0 0 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "not a whole number"),
    ("0.0 3 0 0 0 0 0 0 0\n", "quaternion is zero"),
    ("0.0 3 0 0 0\n", "5 columns, wanted 9")])
def test_a_broken_motion_is_named_by_file_and_line(written, row, fault):
    folder, _ = written
    camera, _ = read_camera(folder / "trajectory.txt", TRUTH.stamps_s)
    path = folder / "broken.txt"
    path.write_text("# comment\n" + row)
    with pytest.raises(BadFile, match=rf"broken\.txt:2: .*{fault}"):
        read_motions(path, TRUTH.stamps_s, camera)


def test_stamps_of_another_clock_are_refused(tmp_path):
    path = tmp_path / "estimate.txt"
    path.write_text("1305031102.16 0 0 0 0 0 0 1\n")
    with pytest.raises(BadFile, match="check the stamps"):
        read_camera(path, TRUTH.stamps_s)


def test_poses_between_frames_are_left_out_and_the_note_says_so(tmp_path):
    path = tmp_path / "estimate.txt"
    path.write_text("".join(f"{t} {x} 0 0 0 0 0 1\n"
                            for t, x in ((0.0, 1), (0.05, 2), (0.1, 3), (0.102, 4))))
    camera, notes = read_camera(path, TRUTH.stamps_s)
    assert camera.pose_known.sum() == 2
    assert camera.T_world_camera[1, 0, 3] == 3.0   # the nearer of two
    assert "2 poses" in notes[0]


def test_motions_over_several_frames_are_left_out_and_the_note_says_so(written):
    folder, _ = written
    camera, _ = read_camera(folder / "trajectory.txt", TRUTH.stamps_s)
    identity = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    path = folder / "wide.txt"
    path.write_text(f"0.0 0.1 3 0 0 0 {identity}\n0.1 0.3 3 0 0 0 {identity}\n")
    motions, notes = read_motions(path, TRUTH.stamps_s, camera)
    assert motions.frame.tolist() == [1]
    assert "1 motions" in notes[0]


def test_a_sequence_without_truth_cannot_be_scored(written):
    folder, _ = written
    sequence = SyntheticSequence(TRUTH)
    sequence.truth = None
    with pytest.raises(UserError, match="no truth"):
        score_to_folder(sequence, folder / "trajectory.txt", None, folder / "scored")
