"""`simbench run` and `simbench score` as typed: exit codes, one line for bad input, the folder."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import yaml

from folders import kitti_folder, picture, save, tum_folder
from simbench.cli import main
from simbench.program import words_of
from simbench.run_folder import prepare

KITTI = Path(__file__).resolve().parents[4] / "shared" / "data" / "kitti_tracking_0003"
SCENE = "SwingingBoxes-v0"
SYSTEM = '''
import numpy as np
from slam.types import FrameEstimate, SlamResult, Status

class Still:
    """Says that nothing ever moves."""
    def __init__(self): self.stamps = []
    def process(self, frame):
        self.stamps.append(frame.stamp_s)
        status = Status.TRACKED if len(self.stamps) > 1 else Status.FIRST
        return FrameEstimate(frame.index, frame.stamp_s, np.eye(4), np.eye(4), status=status,
                             timings_ms={"nothing": 0.0})
    def finish(self):
        n = len(self.stamps)
        return SlamResult(np.array(self.stamps), np.repeat(np.eye(4)[None], n, 0), {},
                          (Status.FIRST,) + (Status.TRACKED,) * (n - 1))

def make(intrinsics): return Still()
'''
PROGRAM = '''
import sys, pathlib
sequence, out = map(pathlib.Path, sys.argv[1:3])
rows = (sequence / "groundtruth.txt").read_text()
(out / "trajectory.txt").write_text(rows)
print("read", len(rows.splitlines()), "rows")
'''


@pytest.fixture
def still(tmp_path) -> str:
    path = tmp_path / "still.py"
    path.write_text(SYSTEM)
    return f"{path}:make"


def test_a_run_on_a_scene_writes_its_folder(tmp_path, still, capsys):
    out = tmp_path / "run"
    code = main(["run", SCENE, "--system", still, "--flow", "noisy", "--flow-sigma", "0.5",
                 "--frames", "6", "--size", "64x48", "--seed", "3", "--out", str(out)])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    assert "camera" in printed.out
    assert str(out / "report.html") in printed.out.replace("\n", "")
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["schema"] == 1
    assert metrics["system"] == still
    assert metrics["sequence"]["frames"] == 6
    assert len(metrics["sequence"]["sha256"]) == 64
    assert metrics["camera"]["coverage"] == 1.0
    assert metrics["camera"]["E_t"] > 1e-4      # the camera does move
    assert 0.3 < metrics["flow"]["epe"] < 1.2   # 0.5 px in u and v: 0.63 on average
    config = yaml.safe_load((out / "config.yaml").read_text())
    assert config["inputs"]["flow"] == "noisy"
    assert config["inputs"]["masks"] == "truth"
    assert config["size"] == [64, 48]
    assert config["seed"] == 3
    assert {p.name for p in out.iterdir()} == {
        "metrics.json", "trajectory.txt", "object_motions.txt", "objects.txt", "report.html",
        "config.yaml", "log.txt"}


def test_equal_seeds_give_equal_estimates_and_metrics(tmp_path):
    words = ["run", SCENE, "--system", "vdo", "--flow", "noisy", "--frames", "4", "--size",
             "128x96", "--seed", "1"]
    for name in ("a", "b"):
        assert main([*words, "--out", str(tmp_path / name)]) == 0
    a, b = (json.loads((tmp_path / name / "metrics.json").read_text()) for name in ("a", "b"))
    a.pop("timing"), b.pop("timing")
    assert a == b
    for name in ("trajectory.txt", "object_motions.txt", "objects.txt", "config.yaml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_program_runs_on_a_rendered_scene_and_is_scored(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    out = tmp_path / "run"
    code = main(["run", SCENE, "--system",
                 f'command:"{sys.executable}" {program} {{sequence}} {{out}}', "--frames", "5",
                 "--size", "64x48", "--out", str(out)])
    assert code == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["camera"]["coverage"] == 1.0
    assert metrics["camera"]["E_t"] < 1e-5
    assert "rows" in (out / "log.txt").read_text()


def test_a_command_in_quotes_is_the_same_command():
    plain = words_of(f"command:{sys.executable} run {{sequence}} {{out}}")
    assert plain == [sys.executable, "run", "{sequence}", "{out}"]
    assert words_of(f"command:\"{sys.executable} run {{sequence}} {{out}}\"") == plain
    assert words_of(f"command:'{sys.executable} run {{sequence}} {{out}}'") == plain


def test_folders_that_are_no_runs_are_left_alone(tmp_path, still, capsys):
    """A sequence, and whatever else is in the way; a run is overwritten, and that is said."""
    sequence, notes, out = tum_folder(tmp_path / "tum"), tmp_path / "notes", tmp_path / "run"
    notes.mkdir()
    (notes / "trajectory.txt").write_text("mine")
    words = ["run", str(sequence), "--system", still, "--out"]
    for folder, says in ((sequence, "is a sequence"), (notes, "holds files that are no run")):
        before = sorted(folder.rglob("*"))
        assert main([*words, str(folder)]) == 2
        assert says in capsys.readouterr().err
        assert sorted(folder.rglob("*")) == before
    assert main([*words, str(out)]) == 0
    prepare(out)
    assert (out / "log.txt").read_text() == "running\n"
    assert main(["score", "--truth", str(sequence), "--trajectory", str(out / "trajectory.txt"),
                 "--out", str(out)]) == 2
    assert "which is to be scored" in capsys.readouterr().err


def test_overwriting_a_run_is_said_once(tmp_path, caplog):
    (tmp_path / "metrics.json").write_text('{"schema": 1, "system": "a", "sequence": {}}')
    prepare(tmp_path)
    prepare(tmp_path)
    assert [r.getMessage() for r in caplog.records] == [
        f"{tmp_path}: overwriting the run that is there"]


def test_a_system_that_fails_on_every_frame_ends_with_1(tmp_path, capsys):
    sequence, broken = tum_folder(tmp_path / "tum"), tmp_path / "broken.py"
    broken.write_text("class A:\n def process(self, f): return 1\n def finish(self): pass\n"
                      "def make(i): return A()\n")
    (sequence / "rgb" / "2.png").unlink()
    assert main(["run", str(sequence), "--system", f"{broken}:make",
                 "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err.splitlines()
    assert "lost every frame (frame 0: the system returned int" in error[-1]
    assert any(x.startswith("WARNING: 1 frame could not be read, first: ") for x in error)
    assert "WARNING: finish: the system returned NoneType, wanted SlamResult" in error


def test_right_images_of_another_size_are_one_line_and_no_run(tmp_path, still, capsys):
    sequence, out = kitti_folder(tmp_path / "kitti"), tmp_path / "run"
    for path in (sequence / "image_1").iterdir():
        save(path, picture(0)[:12])
    assert main(["run", str(sequence), "--system", still, "--out", str(out)]) == 2
    error = [line for line in capsys.readouterr().err.splitlines() if line]
    assert len(error) == 1
    assert "no frame could be read, first: " in error[0]
    assert "32×12" in error[0]
    assert not (out / "metrics.json").exists()
    save(sequence / "image_1" / "000001.png", picture(0)[:, :, :1])   # one that can be read
    assert main(["run", str(sequence), "--system", still, "--out", str(out)]) == 0
    assert "WARNING: 2 frames could not be read, first: " in capsys.readouterr().err


def test_a_program_that_poses_one_frame_alone_loses_the_run(tmp_path, capsys):
    sequence = tum_folder(tmp_path / "tum")
    program = tmp_path / "one_pose.sh"
    program.write_text("#!/bin/sh\necho 100.0 0 0 0 0 0 0 1 > $2/trajectory.txt\n")
    program.chmod(0o755)
    assert main(["run", str(sequence), "--system", f"command:{program} {{sequence}} {{out}}",
                 "--out", str(tmp_path / "run")]) == 1
    assert "wrote a pose for 1 of 4 frames" in capsys.readouterr().err


def bad_inputs(tmp_path: Path) -> list[tuple[list[str], str]]:
    out = ["--out", str(tmp_path / "out")]
    a_file = tmp_path / "file"
    a_file.write_text("")
    empty = tmp_path / "empty"
    empty.mkdir()
    scene = ["run", SCENE, "--system"]
    return [
        (["run", "SwingingBoxs-v0", "--system", "sdpl", *out], "did you mean 'SwingingBoxes-v0'"),
        (["run", str(tmp_path / "gone"), "--system", "sdpl", *out], "no such folder"),
        (["run", str(empty), "--system", "sdpl", *out], "not a sequence of a known kind"),
        ([*scene, "sdlp", "--frames", "2", *out], "did you mean 'sdpl'"),
        ([*scene, "sdpl", "--set", "motion.rouns=3", "--frames", "2", *out],
         "did you mean 'rounds'"),
        ([*scene, "sdpl", "--flow", "perfect", *out], "wanted one of truth, noisy, dis, given"),
        ([*scene, "sdpl", "--dial", "gravity=2", *out], "gravity"),
        ([*scene, "sdpl", "--sensor", "konect", *out], "did you mean 'kinect'"),
        ([*scene, "sdpl", "--frames", "2", "--out", str(a_file)], "is a file, not a folder"),
        ([*scene, "command:ls", *out], "wanted command:"),
        ([*scene, "command:./gone {sequence} {out}", *out], "no program './gone'"),
        (["score", "--truth", str(tmp_path / "gone"), "--trajectory", str(a_file), *out],
         "no such folder"),
        (["score", "--truth", str(tum_folder(tmp_path / "tum")), "--trajectory", str(a_file),
          *out], "has no rows"),
        (["run", SCENE, *out], "--system"),
    ]


@pytest.mark.parametrize("case", range(14))
def test_bad_input_gets_one_line_and_exit_code_2(tmp_path, capsys, case):
    words, says = bad_inputs(tmp_path)[case]
    assert main(words) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert len([x for x in printed.err.splitlines() if x]) == 1
    assert "Traceback" not in printed.err
    assert not (tmp_path / "out" / "metrics.json").exists()


needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"{KITTI} is not here")


@needs_kitti
def test_what_only_scenes_have_is_refused_for_folders(tmp_path, capsys, still):
    for option, value in (("--texture", "0.5"), ("--size", "64x48"), ("--dial", "speed=1"),
                          ("--sensor", "kinect")):
        assert main(["run", str(KITTI), "--system", still, option, value,
                     "--out", str(tmp_path)]) == 2
        assert f"{option} is for scenes" in capsys.readouterr().err
    assert main(["run", str(KITTI), "--system", still, "--flow", "truth",
                 "--out", str(tmp_path)]) == 2
    assert "use --flow dis" in capsys.readouterr().err


@needs_kitti
def test_a_recording_runs_and_its_own_trajectory_scores_the_same(tmp_path, still, capsys):
    run, scored = tmp_path / "run", tmp_path / "scored"
    assert main(["run", str(KITTI), "--system", still, "--frames", "30", "--flow", "given",
                 "--out", str(run)]) == 0
    assert "falls back to dis" in (run / "log.txt").read_text()
    assert main(["score", "--truth", str(KITTI), "--trajectory", str(run / "trajectory.txt"),
                 "--out", str(scored)]) == 0
    one, other = (json.loads((folder / "metrics.json").read_text())["camera"]
                  for folder in (run, scored))
    assert one["E_t"] == pytest.approx(other["E_t"])
    assert one["E_t"] > 1.1                        # it drives at 1.2 m a frame
    assert one["truth_smoothness_floor"]["E_t"] == pytest.approx(0.050, abs=1e-3)
    rows = (run / "trajectory.txt").read_text().splitlines()
    rows[3] = rows[3].replace(" ", " x", 1)
    broken = tmp_path / "broken.txt"
    broken.write_text("\n".join(rows))
    capsys.readouterr()
    assert main(["score", "--truth", str(KITTI), "--trajectory", str(broken),
                 "--out", str(scored)]) == 2
    assert f"{broken}:4:" in capsys.readouterr().err


def test_one_frame_has_nothing_to_score_and_says_so(tmp_path, capsys):
    assert main(["run", "SwingingBoxes-v0", "--system", "vdo", "--frames", "1", "--size", "64x48",
                 "--out", str(tmp_path / "one")]) == 0
    printed = capsys.readouterr().out
    assert "nothing to score" in printed
    assert "camera" not in printed       # no table of names without a number
