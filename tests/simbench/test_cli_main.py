"""Errors of the command line: one line on stderr, exit code 2, a traceback only on request."""

import errno
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
import yaml

from simbench import cli
from simbench.cli import main, view
from simbench.cli.options import collect_dials, parse_size
from simbench.errors import UserError

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("words", "message"), [
    (["nonsense"], "nonsense"),
    (["generate"], "SCENE"),
    (["generate", "SwingingBoxes-v0"], "--out"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--frames", "0"], "--frames"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--workers", "many"], "--workers"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--size", "640"], "640x480"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--size", "9000x480"], "at most 8192"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--dial", "speed"], "NAME=VALUE"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--dial", "objects=2.5"], "whole number"),
    (["generate", "zebra", "--out", "x"], "no scene 'zebra'; `simbench list` shows"),
    (["run", "zebra", "--system", "sdpl", "--out", "x"], "or give the path of a folder"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--dial", "sped=1"], "did you mean 'speed'"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--texture", "7"], "--texture"),
    (["generate", "SwingingBoxes-v0", "--out", "x", "--sensor", "kinekt"], "kinect"),
    (["generate", "SwinginBoxes-v0", "--out", "x"], "did you mean 'SwingingBoxes-v0'"),
    (["verify", "/nowhere/at/all"], "no such folder"),
    (["export", ".", "--format", "tum", "--out", "x"], "not a sequence"),
    (["export", ".", "--format", "bag", "--out", "x"], "there are tum, vdo"),
    (["view", "/nowhere/at/all"], "no such folder"),
])
def test_wrong_input_is_one_line_and_exit_2(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert "Traceback" not in captured.err
    assert list(tmp_path.iterdir()) == []


def test_debug_shows_the_traceback_wherever_it_stands(capsys):
    for words in (["--debug", "verify", "/nowhere"], ["verify", "/nowhere", "--debug"]):
        assert main(words) == 2
        captured = capsys.readouterr()
        assert "Traceback" in captured.err
        assert captured.err.splitlines()[-1].startswith("error: /nowhere: no such folder")


@pytest.mark.parametrize(("error", "code", "message"), [
    (OSError(errno.ENOSPC, "No space left on device", "/out/rgb/1.png"), 2,
     "/out/rgb/1.png: the disk is full"),
    (PermissionError(errno.EACCES, "Permission denied", "/out"), 2, "/out: permission denied"),
    (OSError(errno.EROFS, "Read-only file system", "/out"), 2, "read-only"),
    (OSError(errno.EIO, "Input/output error", "/out"), 2, "/out: Input/output error"),
    (FileExistsError(errno.EEXIST, "File exists", "/out"), 2, "/out: a file stands where a folder"),
    (NotADirectoryError(errno.ENOTDIR, "Not a directory", "/out"), 2, "/out: a file stands where"),
    (KeyboardInterrupt(), 130, "interrupted"),
])
def test_what_the_system_refuses_is_one_line(error, code, message, capsys, monkeypatch):
    def fail():
        raise error

    monkeypatch.setattr(cli.app, "registered_commands", [])
    cli.app.command("fail")(fail)
    cli.app.command("view")(view.view_command)   # a second command: typer flattens a single one
    assert main(["fail"]) == code
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert message in captured.err


def test_a_fault_of_ours_is_not_hidden(monkeypatch):
    def fail():
        raise ZeroDivisionError

    monkeypatch.setattr(cli.app, "registered_commands", [])
    cli.app.command("fail")(fail)
    cli.app.command("view")(view.view_command)
    with pytest.raises(ZeroDivisionError):
        main(["fail"])


def test_help_lists_the_commands_and_loads_nothing_heavy(capsys):
    assert main([]) == 0
    listed = capsys.readouterr().out
    for name in ("list", "generate", "run", "score", "verify", "export", "view"):
        assert f"\n  {name} " in listed
    code = ("import sys, simbench; before = set(sys.modules); import simbench.cli; "
            "simbench.cli.main(['--help']); print([m for m in set(sys.modules) - before "
            "if m in ('mujoco', 'cv2', 'zarr', 'scipy', 'matplotlib', 'rich.progress')])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_version_is_shown(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"simbench {metadata.version('simbench-slam')}\n"


def test_an_empty_argument_is_refused_before_anything_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)      # an empty folder, which --out '' would mean
    assert main(["generate", "SwingingBoxes-v0", "--out", "", "--frames", "1"]) == 2
    assert "an argument is empty" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_no_place_for_compiled_loops_is_one_line(tmp_path):
    (tmp_path / "simbench").mkdir()
    (tmp_path / "simbench" / "__init__.py").write_text(
        "raise RuntimeError(\"cannot cache function 'f': no locator available for 'x.py'\")")
    done = subprocess.run([sys.executable, "-c",
                           f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; "
                           "from simbench_command import main; sys.exit(main())"],
                          capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "set NUMBA_CACHE_DIR" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("words", [("-m", "simbench"), (str(ROOT / "simbench_command.py"),)])
def test_python_starts_the_program_too(words, tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    shown, wrong = (subprocess.run([sys.executable, *words, asked], capture_output=True, text=True,
                                   check=False, cwd=tmp_path, env=environment)
                    for asked in ("--version", "--no-such-option"))
    assert (shown.returncode, shown.stdout.split()[0]) == (0, "simbench")
    assert (wrong.returncode, wrong.stderr.split()[0]) == (2, "error:")


def test_an_interrupt_while_modules_load_is_one_line(tmp_path):
    (tmp_path / "simbench").mkdir()
    (tmp_path / "simbench" / "__init__.py").write_text("raise KeyboardInterrupt\n")
    code = (f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]; "
            "from simbench_command import main; sys.exit(main())")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_list_names_scenes_dials_systems_and_sensors(capsys):
    assert main(["list"]) == 0
    listed = capsys.readouterr().out
    for word in ("SwingingBoxes-v0", "--dial texture=1", "sdpl", "kinect"):
        assert word in listed


def test_list_breaks_its_lines_in_a_terminal_only(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["list"]) == 0
    piped = capsys.readouterr().out
    assert max(map(len, piped.splitlines())) > 100
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["list"]) == 0
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= 60
    assert shown.split() == piped.split()


def test_sizes_and_dials_are_parsed():
    assert parse_size("320x240") == (320, 240)
    assert parse_size(None) is None
    assert collect_dials(["speed=0.5"], 0.25, None) == {"speed": 0.5, "texture": 0.25}
    with pytest.raises(UserError, match="given twice"):
        collect_dials(["texture=1"], 0.5, None)
    assert collect_dials(["people=sitting"], None, None) == {"people": "sitting"}


def test_one_name_is_shown_alone_and_a_suite_as_its_file(capsys):
    assert main(["list", "Office-v0"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("  Office-v0")
    assert "--dial camera_motion=xyz" in shown
    assert "Street-v0" not in shown
    assert main(["list", "smoke"]) == 0
    text = capsys.readouterr().out
    assert yaml.safe_load(text)["cases"]["street"] == {"scene": "Street-v0", "flow": "noisy"}
    assert main(["list", "Ofice-v0"]) == 2
    assert "did you mean 'Office-v0'? `simbench list` shows all" in capsys.readouterr().err
