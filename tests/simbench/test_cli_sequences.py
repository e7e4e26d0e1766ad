"""generate, verify, export and view, as they are typed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from folders import tum_folder, vdo_folder
from simbench.cli import main
from simbench.sequence import open_sequence

SCENE = str(Path(__file__).parent / "scenes" / "stored_room.py") + ":StoredRoom-v0"


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("cli") / "room"
    assert main(["generate", SCENE, "--out", str(out), "--frames", "3", "--seed", "4",
                 "--sensor", "realsense", "--texture", "0.5", "--dial", "light=0.8"]) == 0
    return out


def test_generate_does_what_its_options_say(generated):
    sequence = open_sequence(generated)
    assert len(sequence) == 3
    assert sequence.manifest["seed"] == 4
    assert sequence.manifest["sensor"] == "realsense"
    assert sequence.manifest["dials"] == {"light": 0.8, "texture": 0.5}


def test_generate_tells_its_speed_and_resume_what_was_there(generated, capsys):
    words = ["generate", SCENE, "--out", str(generated), "--frames", "3", "--seed", "4",
             "--sensor", "realsense", "--texture", "0.5", "--dial", "light=0.8"]
    assert main([*words, "--resume"]) == 0
    out = capsys.readouterr().out
    assert "0 frames (3 were there already)" in out
    assert "frames/s" in out
    assert "MB" in out
    assert main(words) == 2
    assert "not empty" in capsys.readouterr().err


def test_verify_passes_and_fails(generated, tmp_path, capsys):
    assert main(["verify", str(generated)]) == 0
    out = capsys.readouterr().out
    assert "3 frames, all good" in out
    assert "drawn here, it has the same bytes" in out
    folder = tum_folder(tmp_path / "tum")
    (folder / "rgb/2.png").unlink()
    assert main(["verify", str(folder)]) == 2
    captured = capsys.readouterr()
    assert "1 problem" in captured.err
    assert captured.err.count("\n") == 1
    assert "rgb/2.png" in captured.out


@pytest.mark.parametrize("layout", ["vdo", "tum", "kitti"])
def test_export_writes_what_verify_accepts(generated, tmp_path, layout, capsys):
    out = str(tmp_path / layout)
    assert main(["export", str(generated), "--format", layout, "--out", out]) == 0
    assert main(["verify", out]) == 0
    assert "3 frames, all good" in capsys.readouterr().out


def test_calibration_is_taken_from_the_option(tmp_path, capsys):
    folder = tum_folder(tmp_path / "tum", calibration=None)
    assert main(["verify", str(folder)]) == 2
    assert "--calibration FILE" in capsys.readouterr().err
    given = tmp_path / "given.yaml"
    given.write_text("width: 32\nheight: 24\nfx: 30\nfy: 30\ncx: 15\ncy: 11\n")
    assert main(["verify", str(folder), "--calibration", str(given)]) == 0


def test_a_contact_sheet_shows_what_there_is(generated, tmp_path):
    sheet = tmp_path / "room.png"
    assert main(["view", str(generated), "--contact-sheet", str(sheet)]) == 0
    image = cv2.imread(str(sheet))
    assert image.shape[1] == 4 * 320   # colour, depth, masks, flow
    assert image.std() > 20
    recording = tmp_path / "vdo.png"
    assert main(["view", str(vdo_folder(tmp_path / "v", 1)), "--contact-sheet",
                 str(recording)]) == 0
    assert cv2.imread(str(recording)).shape[1] == 3 * 320


@pytest.mark.parametrize(("name", "says"), [("gone/room.png", "there is no folder"),
                                            ("room.gif", "must end in .png or .jpg")])
def test_a_contact_sheet_that_cannot_be_is_refused(generated, tmp_path, capsys, name, says):
    assert main(["view", str(generated), "--contact-sheet", str(tmp_path / name)]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_view_names_the_extra_that_is_missing(generated, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["view", str(generated)]) == 2
    assert "pip install -e '.[view]'" in capsys.readouterr().err


def test_a_video_plays_as_long_as_the_sequence(generated, tmp_path, capsys):
    video = tmp_path / "room.mp4"
    assert main(["view", str(generated), "--mp4", str(video)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["room.mp4"]
    played = cv2.VideoCapture(str(video))
    frames = []
    while (read := played.read())[0]:
        frames.append(read[1])
    assert len(frames) == 3
    assert played.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    assert frames[0].shape[1] == 2 * 320
    # Colour stands top left, below its title: the same picture, but for compression.
    wanted = cv2.resize(open_sequence(generated).frame(1).rgb[..., ::-1], (320, 240),
                        interpolation=cv2.INTER_AREA)
    assert np.abs(frames[1][18:258, :320].astype(float) - wanted).mean() < 6.0
    assert main(["view", str(generated), "--mp4", str(tmp_path / "room.avi")]) == 2
    assert "must end in .mp4" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["generate", SCENE, "--out", str(tmp_path / "file" / "below")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "file" in error


@pytest.mark.parametrize("after", ["unfinished.json", "rgb/000000.png"])
def test_an_interrupt_ends_the_rendering_processes_without_a_word_of_theirs(tmp_path, after):
    out = tmp_path / "room"
    started = subprocess.Popen(
        # A shell's background jobs, and so their children, would ignore the interrupt.
        [sys.executable, "-c", "import signal, sys; signal.signal(signal.SIGINT, "
         "signal.default_int_handler); from simbench.cli import main; sys.exit(main())",
         "generate", SCENE, "--out", str(out), "--frames", "2000", "--workers", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    end_s = time.monotonic() + 120.0
    while not (out / after).exists() and time.monotonic() < end_s:
        time.sleep(0.05)
    os.killpg(started.pid, signal.SIGINT)       # as a terminal does: to all of them
    _, said = started.communicate(timeout=60)
    assert (started.returncode, said) == (130, "interrupted\n")
    assert (out / "unfinished.json").exists()   # for --resume


def test_a_folder_of_results_is_named_as_such(tmp_path, capsys):
    for name, what in (("metrics.json", "holds a run"), ("suite.json", "holds a suite's runs")):
        folder = tmp_path / name.removesuffix(".json")
        folder.mkdir()
        (folder / name).write_text("{}")
        assert main(["verify", str(folder)]) == 2
        assert f"{what}, no sequence" in capsys.readouterr().err
