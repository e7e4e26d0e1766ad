"""Sequences in object storage: stored, fetched once, checked, and never led out of the cache."""

import json
import uuid
from pathlib import Path

import pytest
from numpy.testing import assert_array_equal

from folders import tum_folder
from simbench.cli import main
from simbench.errors import BadFile, UserError
from simbench.remote import local_folder, store
from simbench.sequence import open_sequence
from simbench.storage import file_hashes

fsspec = pytest.importorskip("fsspec")
SCENE = str(Path(__file__).parent / "scenes" / "stored_room.py") + ":StoredRoom-v0"


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("remote") / "room"
    assert main(["generate", SCENE, "--out", str(out), "--frames", "2"]) == 0
    return out


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SIMBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(params=["memory", "file"])
def url(request, tmp_path):
    return f"memory://{uuid.uuid4()}/room" if request.param == "memory" \
        else f"file://{tmp_path / 'store' / 'room'}"


def test_what_is_stored_is_what_is_read(generated, url, cache):
    store(generated, url)
    read, here = open_sequence(url), open_sequence(generated)
    assert read.fingerprint() == here.fingerprint()
    assert_array_equal(read.frame(1).depth_m, here.frame(1).depth_m)
    assert file_hashes(local_folder(url)) == file_hashes(generated)
    kept, = cache.iterdir()                     # once, and nothing half-fetched beside it
    files, root = fsspec.core.url_to_fs(url)
    files.rm(f"{root}/rgb", recursive=True)     # not asked for again
    assert open_sequence(url).folder == kept
    with pytest.raises(UserError, match="something is there already"):
        store(generated, url)


def test_generate_writes_to_a_url_and_the_other_commands_read_it(generated, tmp_path, capsys):
    url = f"file://{tmp_path / 'store'}"
    assert main(["generate", SCENE, "--out", url, "--frames", "2"]) == 0
    assert file_hashes(tmp_path / "store") == file_hashes(generated)
    assert main(["verify", url]) == 0
    assert "2 frames, all good" in capsys.readouterr().out
    assert main(["export", url, "--format", "tum", "--out", str(tmp_path / "tum")]) == 0
    assert main(["generate", SCENE, "--out", url, "--frames", "2"]) == 2
    assert "something is there already" in capsys.readouterr().err


def test_a_recording_without_a_manifest_is_fetched_again_when_it_changes(tmp_path, url, cache):
    folder = tum_folder(tmp_path / "tum")
    store(folder, url)
    assert len(open_sequence(url)) == 4
    files, root = fsspec.core.url_to_fs(url)
    rows = (folder / "rgb.txt").read_text().splitlines()
    files.pipe_file(f"{root}/rgb.txt", "\n".join(rows[:-1]).encode())
    assert len(open_sequence(url)) == 3
    assert len(list(cache.iterdir())) == 2


def test_a_damaged_file_is_noticed(generated, url, cache):
    store(generated, url)
    files, root = fsspec.core.url_to_fs(url)
    files.pipe_file(f"{root}/rgb/000001.png", b"other")
    with pytest.raises(BadFile, match=r"000001\.png: not the file that sequence\.json names"):
        open_sequence(url)
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize("name", ["../outside.txt", "/etc/outside.txt", "rgb/../../outside.txt"])
def test_no_name_leads_out_of_the_cache(tmp_path, name):
    url = f"memory://{uuid.uuid4()}/room"
    files, root = fsspec.core.url_to_fs(url)
    files.pipe_file(f"{root}/sequence.json", json.dumps({"files": {name: "0" * 64}}).encode())
    with pytest.raises(BadFile, match="leads out of its folder"):
        open_sequence(url)
    assert not list(tmp_path.rglob("outside.txt"))


@pytest.mark.parametrize(("place", "says"), [
    ("memory://nowhere/at-all", "nothing is there"),
    ("nothing://here", "nothing"),
    ("file:///proc/1/mem", "")])
def test_a_place_without_a_sequence_is_one_line(capsys, place, says):
    assert main(["verify", place]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert says in error


@pytest.mark.parametrize("manifest", [b"", b"{", b"[]", b'{"files": 3}', b"[" * 100_000])
def test_a_broken_manifest_is_one_line(manifest):
    url = f"memory://{uuid.uuid4()}/room"
    files, root = fsspec.core.url_to_fs(url)
    files.pipe_file(f"{root}/sequence.json", manifest)
    with pytest.raises(BadFile, match="not a manifest"):
        open_sequence(url)


def test_without_fsspec_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "fsspec", None)
    with pytest.raises(UserError, match=r"pip install -e '\.\[storage\]"):
        open_sequence("s3://bucket/room")
