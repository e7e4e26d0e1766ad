"""`simbench run` from the command line to the report, on recordings and on a rendered scene."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from folders import tum_folder
from simbench.cli import main

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
RUN_FILES = {"metrics.json", "trajectory.txt", "object_motions.txt", "objects.txt", "report.html",
             "config.yaml", "log.txt"}


def run(source, out, *options) -> dict:
    """The metrics of a run that ends with exit code 0."""
    assert main(["run", str(source), "--out", str(out), *options]) == 0
    return json.loads((out / "metrics.json").read_text())


# Errors a little above ours on so few frames. Standing still would be wrong by the motion itself:
# 1.2 m, 0.02 m and 1.5°, 1 cm, 1 m a frame.
RECORDINGS = {
    "kitti_tracking_0003": (["--frames", "8", "--flow", "dis"], 0.10, 0.06),
    "tum_fr1_rpy": (["--frames", "8"], 0.015, 0.7),
    "tum_fr3_structure_notexture_far": (["--frames", "8"], 0.01, 0.3),
    # Its truth turns by the same angle in every frame: rotation is not known to better than this.
    "kitti_odometry_06": (["--frames", "5", "--depth", "stereo"], 0.05, 0.2),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_run_with_full_coverage_and_small_errors(tmp_path, name):
    if not (DATA / name).is_dir():
        pytest.skip(f"{DATA / name} is not here")
    options, t_m, r_deg = RECORDINGS[name]
    metrics = run(DATA / name, tmp_path, "--system", "sdpl", *options)
    camera = metrics["camera"]
    assert camera["coverage"] == 1.0
    assert camera["E_t"] < t_m
    assert camera["E_R"] < r_deg
    assert {p.name for p in tmp_path.iterdir()} >= RUN_FILES


def test_without_masks_the_camera_stays_with_the_room_while_people_walk_by(tmp_path):
    metrics = run("Office-v0", tmp_path, "--system", "sdpl", "--frames", "5", "--seed", "34",
                  "--sensor", "gaussian", "--flow", "dis", "--masks", "none")
    assert metrics["camera"]["E_t"] < 0.002                # they walk by 0.03 m in a frame


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    """A short run on the rendered scene: its folder and metrics."""
    out = tmp_path_factory.mktemp("run")
    return out, run("SwingingBoxes-v0", out, "--system", "sdpl", "--frames", "12", "--size",
                    "320x240", "--flow", "truth")


def test_a_rendered_scene_leaves_a_whole_run_behind(swinging):
    out, metrics = swinging
    assert {p.name for p in out.iterdir()} >= RUN_FILES
    assert metrics["camera"]["coverage"] == 1.0
    assert metrics["camera"]["E_t"] < 5e-4
    assert metrics["camera"]["E_R"] < 0.01
    assert metrics["objects"]["mean"]["coverage"] > 0.8
    assert metrics["objects"]["mean"]["E_t"] < 2e-3
    assert metrics["objects"]["mean"]["id_switches"] == 0
    assert set(metrics["timing"]["stages_ms"]) >= {"observe", "match", "motion", "detect"}
    rows = np.loadtxt(out / "trajectory.txt")
    assert rows.shape == (12, 8)
    assert len((out / "object_motions.txt").read_text().splitlines()) >= 0.8 * 4 * 11
    report = (out / "report.html").read_text()
    assert report.count("data:image/") >= 1
    assert "http://" not in report.replace("http://www.w3.org/", "")


def test_the_settings_that_were_used_are_written_down(swinging):
    out, _ = swinging
    text = (out / "config.yaml").read_text()
    config = yaml.safe_load(text)
    assert "kernel" in text
    assert "SwingingBoxes-v0" in text
    assert config


def test_a_second_run_writes_the_same_trajectory(swinging, tmp_path):
    out, _ = swinging
    run("SwingingBoxes-v0", tmp_path, "--system", "sdpl", "--frames", "4", "--size", "320x240",
        "--flow", "truth")
    whole = (out / "trajectory.txt").read_text().splitlines()
    assert (tmp_path / "trajectory.txt").read_text().splitlines() == whole[:4]


def test_settings_reach_the_system(tmp_path):
    plain, coarse = (run("SwingingBoxes-v0", tmp_path / name, "--system", "vdo", "--frames", "2",
                         "--size", "160x120", "--flow", "truth", *extra)
                     for name, extra in (("a", ()), ("b", ("--set", "grid.static_cell_px=16"))))
    assert plain["camera"]["E_t"] != coarse["camera"]["E_t"]
    assert "static_cell_px: 16" in (tmp_path / "b" / "config.yaml").read_text()


def test_a_truncated_picture_is_one_lost_frame_and_the_run_goes_on(tmp_path):
    made, folder = tmp_path / "made", tmp_path / "recording"
    assert main(["generate", "SwingingBoxes-v0", "--frames", "6", "--size", "160x120",
                 "--out", str(made)]) == 0
    assert main(["export", str(made), "--format", "tum", "--out", str(folder)]) == 0
    spoilt, gone = sorted((folder / "rgb").glob("*.png"))[2:4]
    spoilt.write_bytes(spoilt.read_bytes()[:40])
    gone.unlink()
    coverage = run(folder, tmp_path / "run", "--system", "sdpl")["camera"]["coverage"]
    assert 0 < coverage < 1
    log = (tmp_path / "run" / "log.txt").read_text()
    assert "frame 2: lost" in log
    assert spoilt.name in log
    assert gone.name in log


def bad_inputs(folder: Path) -> dict[str, tuple[list[str], str]]:
    """What is typed, and a word that the one line about it must hold."""
    out = ["--out", str(folder / "out")]
    scene = ["run", "SwingingBoxes-v0", "--system", "sdpl", "--frames", "2"]
    a_file = folder / "a_file"
    a_file.write_text("")
    bare = tum_folder(folder / "bare", calibration=None)
    return {
        "unknown scene": (["run", "Street-v9", "--system", "sdpl", *out], "Street-v0"),
        "unknown system": ([*scene[:3], "orbslam", *out], "sdpl"),
        "unknown sensor": ([*scene, "--sensor", "lidar", *out], "kinect"),
        "unknown dial": ([*scene, "--dial", "colour=1", *out], "colour"),
        "dial too large": ([*scene, "--dial", "speed=1e9", *out], "speed"),
        "dial no number": ([*scene, "--dial", "speed=fast", *out], "fast"),
        "texture too large": ([*scene, "--texture", "1.5", *out], "texture"),
        "setting without value": ([*scene, "--set", "motion.rounds", *out], "motion.rounds"),
        "setting of another kind": ([*scene, "--set", "motion.rounds=many", *out], "many"),
        "setting not offered": ([*scene, "--set", "motion.kernel=tukey", *out], "tukey"),
        "unknown stage": ([*scene, "--set", "motoin.rounds=3", *out], "motion"),
        "size no size": ([*scene, "--size", "640", *out], "640"),
        "no frames": ([*scene[:-1], "0", *out], "frames"),
        "negative seed": ([*scene, "--seed", "-1", *out], "seed"),
        "out below a file": ([*scene, "--out", str(a_file / "run")], "a_file"),
        "out is a file": ([*scene, "--out", str(a_file)], "a_file"),
        "no calibration": (["run", str(bare), "--system", "sdpl", *out], "calibration"),
        "calibration not there": (["run", str(bare), "--system", "sdpl", "--calibration",
                                   str(folder / "no.yaml"), *out], "no.yaml"),
        "calibration for a scene": ([*scene, "--calibration", "x.yaml", *out], "calibration"),
        "flow not in the folder": (["run", str(tum_folder(folder / "tum")), "--system", "sdpl",
                                    "--flow", "truth", *out], "flow"),
    }


NAMES = ["unknown scene", "unknown system", "unknown sensor", "unknown dial", "dial too large",
         "dial no number", "texture too large", "setting without value",
         "setting of another kind", "setting not offered", "unknown stage", "size no size",
         "no frames", "negative seed", "out below a file", "out is a file", "no calibration",
         "calibration not there", "calibration for a scene", "flow not in the folder"]


@pytest.mark.parametrize("name", NAMES)
def test_bad_input_gets_exit_code_2_and_one_line_that_names_it(tmp_path, capsys, name):
    words, says = bad_inputs(tmp_path)[name]
    assert main(words) == 2
    printed = capsys.readouterr().err
    lines = [line for line in printed.splitlines() if line.strip()]
    assert len(lines) == 1, printed
    assert lines[0].startswith("error: ")
    assert says in lines[0]
    assert "Traceback" not in printed
    assert not (tmp_path / "out" / "metrics.json").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_named(tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert main(["run", "SwingingBoxes-v0", "--system", "sdpl", "--frames", "2",
                 "--out", str(tmp_path / "run")]) == 2
    assert str(tmp_path) in capsys.readouterr().err
