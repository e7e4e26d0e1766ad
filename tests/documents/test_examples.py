"""The examples run, and what they print is what their first lines promise."""

from __future__ import annotations

import importlib.util
import re
from types import ModuleType

import cv2
import pytest

from document_blocks import ROOT
from simbench.cli import main

EXAMPLES = ROOT / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_table_names_every_example():
    told = set(re.findall(r"\]\((\w+)\.py\)", (EXAMPLES / "README.md").read_text()))
    assert told == {path.stem for path in EXAMPLES.glob("*.py")}


def test_steering_prints_an_error_for_each_shaking(capsys: pytest.CaptureFixture[str]):
    example("steer_the_camera").main(["--frames", "3"])
    errors_mm = re.findall(r"E_t (\S+) mm", capsys.readouterr().out)
    assert len(errors_mm) == 2
    assert all(0 < float(error) < 10 for error in errors_mm)


def test_each_choice_of_inputs_has_its_errors(capsys: pytest.CaptureFixture[str]):
    module = example("which_input_hurts")
    module.main(["--frames", "3"])
    lines = capsys.readouterr().out.splitlines()
    assert [line[:21].strip() for line in lines] == list(module.CHOICES)
    error_mm = {line[:21].strip(): float(re.search(r"camera +(\S+) mm", line)[1]) for line in lines}
    assert error_mm["both"] > error_mm["all true"]


def test_the_library_alone_tracks_a_folder(tmp_path, capsys: pytest.CaptureFixture[str]):
    assert main(["generate", "SwingingBoxes-v0", "--frames", "3", "--size", "320x240", "--out",
                 str(tmp_path / "boxes")]) == 0
    capsys.readouterr()
    example("slam_alone").main([str(tmp_path / "boxes"), "--focal-px", "277.3"])
    printed = capsys.readouterr().out
    assert printed.count(": tracked, camera at") == 2
    assert printed.endswith("3 poses\n")


def test_the_policy_is_held_against_the_fixed_path(capsys: pytest.CaptureFixture[str]):
    example("active_camera").main(["--seeds", "2", "--frames", "3"])
    printed = capsys.readouterr().out
    assert len(re.findall(r"^\| \d ", printed, flags=re.MULTILINE)) == 2
    assert re.search(r"^E_t: \S+ % \[\S+, \S+\] against the fixed path$", printed, re.MULTILINE)


def test_truth_is_drawn(tmp_path, capsys: pytest.CaptureFixture[str]):
    example("draw_truth").main(["--out", str(tmp_path / "truth.png")])
    picture = cv2.imread(str(tmp_path / "truth.png"))
    assert picture.shape == (480, 640, 3)
    assert (picture == (0, 0, 255)).all(axis=-1).sum() > 1000    # what is going to be hidden
    assert (picture == (255, 0, 0)).all(axis=-1).sum() > 1000    # what is going to leave
    assert int(re.search(r"(\d+) visible edges", capsys.readouterr().out)[1]) > 100
