"""A suite elsewhere: on a Dask cluster, and with its sequences in a cache."""

import json

import pytest

from simbench.cli import main
from simbench.errors import UserError
from simbench.generate import GenerateSettings
from simbench.suites.cache import SequenceCache
from simbench.suites.pool import dask_workers
from tiny_suite import SUITE

FEW = ("--frames", "3", "--reports", "none")
SETTINGS = GenerateSettings.resolve("SwingingBoxes-v0", frames=2, size=(48, 32))


def compared(out):
    """What of the results does not depend on where they were made, or when."""
    results = json.loads((out / "results.json").read_text())
    files = {run["folder"]: [(out / run["folder"] / name).read_bytes()
                             for name in ("trajectory.txt", "object_motions.txt")]
             for run in results["runs"]}
    return results, files


def test_a_cluster_gives_the_bits_that_this_process_gives(tmp_path, in_this_process):
    distributed = pytest.importorskip("distributed")
    path = tmp_path / "tiny.yaml"
    path.write_text(SUITE)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True,
                                  dashboard_address=None) as cluster:
        assert main(["suite", str(path), *FEW, "--dask", cluster.scheduler_address, "--out",
                     str(tmp_path / "dask")]) == 0
    assert main(["suite", str(path), *FEW, "--out", str(tmp_path / "here")]) == 0
    assert compared(tmp_path / "dask") == compared(tmp_path / "here")


def test_no_cluster_is_one_line(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("simbench.suites.pool._DASK_WAIT_S", 1)
    with pytest.raises(UserError, match="no scheduler answers there"), \
            dask_workers("tcp://127.0.0.1:9"):
        pass
    for address in ("nowhere", "tcp://nowhere", "foo://here:1"):
        with pytest.raises(UserError, match=f"{address}: .*wanted one as in tcp://host:8786"), \
                dask_workers(address):
            pass


@pytest.mark.parametrize("kind", ["folder", "file://", "memory://"])
def test_a_sequence_is_rendered_once_and_found_again(tmp_path, monkeypatch, kind):
    if kind != "folder":
        pytest.importorskip("fsspec")
    place = {"folder": str(tmp_path / "cache"), "file://": f"file://{tmp_path / 'cache'}",
             "memory://": f"memory://{tmp_path.name}"}[kind]
    with SequenceCache(place).folder_of(SETTINGS) as folder:
        first = {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    monkeypatch.setattr("simbench.suites.cache.generate", None)      # not again
    with SequenceCache(place).folder_of(SETTINGS) as folder:
        again = {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert first == again
    assert "sequence.json" in {path.name for path in first}


def test_a_suite_from_the_cache_gives_the_same_metrics(tmp_path, in_this_process):
    path = tmp_path / "tiny.yaml"
    path.write_text(SUITE)
    for out, options in (("here", []), ("cached", ["--cache", str(tmp_path / "cache")])):
        assert main(["suite", str(path), "--seeds", "0", *FEW, *options, "--out",
                     str(tmp_path / out)]) == 0
    one, other = (json.loads((tmp_path / out / "results.json").read_text())["runs"]
                  for out in ("here", "cached"))
    assert [run["metrics"] for run in one] == [run["metrics"] for run in other]
    assert [run["sequence"]["given_sha256"] for run in one] \
        == [run["sequence"]["given_sha256"] for run in other]
    assert len([p for p in (tmp_path / "cache").iterdir() if p.is_dir()]) == 2


def test_a_storage_that_there_is_not_is_one_line():
    pytest.importorskip("fsspec")
    with pytest.raises(UserError, match="--cache nothing://here"):
        SequenceCache("nothing://here")


def test_a_cache_that_cannot_be_written_stops_a_suite_before_it_begins(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    out = tmp_path / "out"
    for more in (["smoke"], ["break", "--dial", "texture"]):
        assert main(["suite", *more, "--out", str(out), "--cache",
                     str(tmp_path / "file" / "cache")]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert str(tmp_path / "file") in said
        assert not out.exists()
