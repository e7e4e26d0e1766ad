"""Where compiled loops are kept when neither the installation nor the home may be written."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from slam.loop_cache import VARIABLE, find_place

ROOT = Path(__file__).resolve().parents[2]


def closed(folder: Path) -> Path:
    """A package in whose place for compiled files nobody, not even root, can make a file."""
    folder.mkdir(exist_ok=True)
    (folder / "__pycache__").write_text("in the way")
    return folder


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No variable, no cache of the user's; a temporary folder of the test's own."""
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    return closed(tmp_path / "package")


def test_a_place_of_numbas_own_is_left_to_it(nowhere, tmp_path, monkeypatch, caplog):
    (tmp_path / "open").mkdir()
    find_place(tmp_path / "open")
    assert not os.environ[VARIABLE]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    find_place(nowhere)
    assert not os.environ[VARIABLE]
    monkeypatch.setenv(VARIABLE, "/somewhere")
    find_place(nowhere)
    assert os.environ[VARIABLE] == "/somewhere"
    assert not caplog.records


def test_without_one_there_is_one_folder_for_all_runs(nowhere, tmp_path, monkeypatch, caplog):
    find_place(nowhere)
    first = Path(os.environ[VARIABLE])
    assert first.parent == tmp_path / "tmp"
    assert first.stat().st_mode & 0o777 == 0o700
    assert len(caplog.records) == 1
    assert str(first) in caplog.text
    monkeypatch.setenv(VARIABLE, "")
    find_place(nowhere)
    assert os.environ[VARIABLE] == str(first)


@pytest.mark.parametrize("of_another", ["open", "link"])
def test_a_folder_that_others_could_have_filled_is_not_used(nowhere, tmp_path, monkeypatch,
                                                            of_another):
    find_place(nowhere)
    first = Path(os.environ[VARIABLE])
    if of_another == "open":
        first.chmod(0o777)
    else:
        first.rename(tmp_path / "theirs")
        first.symlink_to(tmp_path / "theirs")
    monkeypatch.setenv(VARIABLE, "")
    find_place(nowhere)
    second = Path(os.environ[VARIABLE])
    assert second != first
    assert not any(second.iterdir())


def test_where_no_folder_can_be_had_numba_may_say_so(nowhere, monkeypatch, caplog):
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null")
    find_place(nowhere)
    assert not os.environ[VARIABLE]
    assert not caplog.records


@pytest.mark.parametrize("words", [("-c", "import slam; print('simbench')"),
                                   ("-m", "simbench", "--version")])
def test_a_read_only_installation_runs_with_one_line_of_warning(tmp_path, words):
    for package in ("simbench", "slam"):
        shutil.copytree(ROOT / package, tmp_path / package,
                        ignore=shutil.ignore_patterns("__pycache__"))
        for folder in [tmp_path / package, *(tmp_path / package).rglob("*/")]:
            closed(folder)
    (tmp_path / "tmp").mkdir()
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(
        [sys.executable, *words], capture_output=True, text=True,
        check=False, cwd=tmp_path, env=environment | {
            "PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": "/dev/null",
            "TMPDIR": str(tmp_path / "tmp")})
    assert (done.returncode, done.stdout.split()[0]) == (0, "simbench")
    assert done.stderr.startswith("compiled loops are kept in " + str(tmp_path / "tmp"))
    assert done.stderr.count("\n") == 1
