"""`simbench suite` as typed: results, resuming to the same bytes, what is lost, what is refused."""

import json
import shutil
import sys

import pytest

from browser import opened
from folders import tum_folder
from simbench.cli import main
from tiny_suite import SUITE

BROKEN = '''
class Broken:
    def process(self, frame): raise ValueError("not today")
    def finish(self): raise ValueError("nor now")

def make(intrinsics): return Broken()
'''


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """The suite's file, and the folder it was run to."""
    folder = tmp_path_factory.mktemp("suite")
    path = folder / "tiny.yaml"
    path.write_text(SUITE)
    assert main(["suite", str(path), "--workers", "2", "--reports", "none", "--out",
                 str(folder / "out")]) == 0
    return path, folder / "out"


def test_a_suite_killed_before_it_had_begun_is_begun_by_resume(tmp_path, in_this_process):
    path, out = tmp_path / "tiny.yaml", tmp_path / "out"
    path.write_text(SUITE)
    (out / "records").mkdir(parents=True)
    (out / "suite.json.partial").write_text("{")
    command = ["suite", str(path), "--seeds", "0", "--frames", "2", "--reports", "none", "--out",
               str(out)]
    assert main(command) == 2
    assert main([*command, "--resume"]) == 0
    assert (out / "results.json").is_file()


def test_results_hold_every_run_and_the_means_with_intervals(suite):
    _, out = suite
    results = json.loads((out / "results.json").read_text())
    assert len(results["runs"]) == 4
    assert all(run["status"] == "done" for run in results["runs"])
    assert all(run["sequence"]["given_sha256"] for run in results["runs"])
    assert "timing" not in json.dumps(results)
    cell = results["summary"][0]
    assert (cell["point"], cell["system"], cell["runs"]) == ({"texture": 1}, "sdpl", 2)
    error = cell["metrics"]["camera.E_t"]
    assert error["low"] <= error["mean"] <= error["high"]
    assert error["n"] == 2
    full, plain = (m["corners_per_mp"] for m in results["meaning"])
    assert plain < full
    rows = (out / "results.csv").read_text().splitlines()
    assert len(rows) == 5
    assert rows[0].startswith("case,system,texture,seed,status,frames,lost_frames,camera.E_R")


def test_the_page_stands_alone_and_its_links_lead_somewhere(suite):
    _, out = suite
    page = (out / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org/", "")
    assert "<script" not in page
    assert page.count("<svg") == 4          # two metrics and two coverages over one dial
    assert "corners (per megapixel)" in page
    links = [part.split('"')[0] for part in page.split('href="runs/')[1:]]
    assert len(links) == 4
    for link in links:
        assert (out / "runs" / link.replace("%3D", "=")).is_file()


def test_a_browser_draws_the_page_on_a_phone(suite, tmp_path):
    path = tmp_path / "report.html"
    path.write_text((suite[1] / "report.html").read_text())
    seen = opened(path, 390)
    assert (seen.faults, seen.empty, seen.small) == ([], 0, 0)
    assert seen.width <= 390


def test_a_suite_that_was_cut_short_resumes_to_the_same_bytes(suite, tmp_path, capsys,
                                                              in_this_process):
    path, out = suite
    again = tmp_path / "again"
    shutil.copytree(out, again)
    for name in ("results.json", "results.csv", "report.html"):
        (again / name).unlink()
    records = sorted((again / "records").iterdir())
    records[0].unlink()                          # killed before this run was kept …
    records[1].write_bytes(records[1].read_bytes()[:100])   # … and this record is cut short
    assert main(["suite", str(path), "--workers", "1", "--out", str(again)]) == 2
    assert "--resume" in capsys.readouterr().err
    assert main(["suite", str(path), "--reports", "none", "--resume", "--out", str(again)]) == 0
    for name in ("results.json", "results.csv"):
        assert (again / name).read_bytes() == (out / name).read_bytes()
    for run in json.loads((out / "results.json").read_text())["runs"]:
        for name in ("trajectory.txt", "object_motions.txt"):
            one, other = (place / run["folder"] / name for place in (out, again))
            assert one.read_bytes() == other.read_bytes()


def test_a_run_done_otherwise_is_not_written_over(suite, tmp_path, capsys, in_this_process):
    path, out = suite
    again = tmp_path / "again"
    shutil.copytree(out, again)
    command = ["suite", str(path), "--reports", "none", "--resume", "--out", str(again)]
    folder = "runs/boxes/texture=1/sdpl/seed0"
    for options, what in (("--frames 3", "with frames 4, not 3"),
                          ("--size 64x48", "with size [96, 72], not [64, 48]")):
        assert main([*command, *options.split()]) == 2
        error = capsys.readouterr().err
        assert f"{again / folder}: was done {what}; choose another --out" in error
        assert error.count("\n") == 1
    path.with_name("noisy.yaml").write_text(SUITE.replace("gaussian", "kinect"))
    assert main([*command[:1], str(path.with_name("noisy.yaml")), *command[2:]]) == 2
    assert 'with input sensor "gaussian", not "kinect"' in capsys.readouterr().err
    for file in (out / "suite.json", *out.glob("records/*"), *out.glob("runs/**/trajectory.txt")):
        assert (again / file.relative_to(out)).read_bytes() == file.read_bytes()


def test_no_gate_takes_old_results_for_those_of_a_suite_that_is_resumed(suite, tmp_path, capsys,
                                                                        monkeypatch):
    path, out = suite
    again = tmp_path / "again"
    shutil.copytree(out, again)

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("simbench.suites.run_suite.perform_all", killed)
    assert main(["suite", str(path), "--seeds", "0-2", "--resume", "--out", str(again)]) == 130
    capsys.readouterr()
    assert main(["bless", str(again), "--baseline", str(tmp_path / "baseline.json")]) == 2
    assert "this suite is not finished; finish it with --resume" in capsys.readouterr().err


def test_a_run_whose_folder_is_gone_is_done_again(suite, tmp_path, in_this_process):
    path, out = suite
    again = tmp_path / "again"
    shutil.copytree(out, again)
    lost = again / "runs/boxes/texture=1/sdpl/seed0"
    shutil.rmtree(lost)
    assert main(["suite", str(path), "--reports", "none", "--resume", "--out", str(again)]) == 0
    assert (lost / "trajectory.txt").read_bytes() == (
        out / lost.relative_to(again) / "trajectory.txt").read_bytes()


RECORDED = """
schema: 1
name: recorded
systems: [sdpl]
seeds: 0-0
cases:
  street: {folder: FOLDER, frames: 2, masks: MASKS}
"""


@pytest.mark.parametrize(("folder", "masks", "message"), [
    ("gone", "given", "case street: gone: no such folder; give the folder of a sequence"),
    ("bare", "given", "case street: bare: no calibration"),
    ("tum", "truth", "case street: --masks truth: tum has no true masks"),
])
def test_a_recording_that_cannot_be_run_is_named_before_anything_is(
        tmp_path, monkeypatch, capsys, folder, masks, message):
    monkeypatch.chdir(tmp_path)
    tum_folder(tmp_path / "bare", calibration=None)
    tum_folder(tmp_path / "tum")
    (tmp_path / "recorded.yaml").write_text(
        RECORDED.replace("FOLDER", folder).replace("MASKS", masks))
    assert main(["suite", "recorded.yaml", "--out", "out"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("old", "new", "message"), [
    ("96x72", "9999x9999", "case boxes: scene SwingingBoxes-v0: size 9999x9999 must be from 8"),
    ("frames: 4", "frames: 100000000000",
     "case boxes: scene SwingingBoxes-v0: 100000000000 frames; wanted 1 to 1000000"),
    ("sensor:", "detector: gone.onnx\n    sensor:",
     "case boxes: --detector gone.onnx: no such file"),
    ("[sdpl]", "[etc/passwd:make]", "etc/passwd is no Python file; wanted path/to/file.py:factory"),
])
def test_what_could_only_fail_is_refused_before_anything_is(tmp_path, capsys, old, new, message):
    path = tmp_path / "tiny.yaml"
    path.write_text(SUITE.replace(old, new))
    assert main(["suite", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_system_that_loses_its_runs_is_shown_and_exits_with_1(suite, tmp_path, capsys,
                                                                in_this_process):
    path, _ = suite
    broken = tmp_path / "broken.py"
    broken.write_text(BROKEN)
    program = f"command:{sys.executable} -c exit(3) {{sequence}} {{out}}"
    assert main(["suite", str(path), "--systems", f"{broken}:make,{program}", "--seeds", "5",
                 "--workers", "1", "--frames", "3", "--reports", "none", "--out",
                 str(tmp_path / "out")]) == 1
    assert "4 of 4 runs lost or failed" in capsys.readouterr().err
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [run["status"] for run in results["runs"]] == ["lost"] * 4
    assert {run["lost_frames"] for run in results["runs"]} == {3}
    reasons = {run["system"]: run["reason"] for run in results["runs"]}
    assert "not today" in reasons[f"{broken}:make"]
    assert "ended with 3" in reasons[program]
    assert results["summary"][0]["metrics"]["camera.coverage"]["mean"] == 0.0


@pytest.mark.parametrize(("options", "message"), [
    (["nothing"], "no suite 'nothing'"),
    (["smoke", "--systems", "sdpl,"], "names with commas between"),
    (["smoke", "--cases", "boxes,boats"], "no case 'boats'; it has boxes, street"),
    (["break", "--dial", "texture", "--cases", "boxes"], "a search has none"),
    (["smoke", "--systems", "sdlp"], "did you mean 'sdpl'"),
    (["smoke", "--seeds", "x"], "wanted numbers and ranges"),
    (["smoke", "--reports", "some"], "wanted first, all or none"),
    (["smoke", "--dask", "tcp://localhost:1", "--workers", "2"], "leave it out with --dask"),
    (["gone.yaml"], "gone.yaml: no such file; check the path"),
])
def test_wrong_words_are_one_line_and_exit_with_2(tmp_path, capsys, options, message):
    assert main(["suite", *options, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("years of work")
    assert main(["suite", "smoke", "--out", str(tmp_path), "--resume"]) == 2
    assert "no suite was begun here" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
