"""What `view` hands to Rerun, read back from the file it saves."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

from folders import tum_folder
from simbench.cli import main
from simbench.errors import BadFile
from simbench.ply import ply_text, read_ply
from simbench.sequence import open_sequence
from simbench.trajectory_files import tum_lines
from slam.geometry import se3

rerun = pytest.importorskip("rerun")
SCENE = str(Path(__file__).parent / "scenes" / "stored_room.py") + ":StoredRoom-v0"
POINTS = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 2.0], [0.0, 0.0, 4.0]])
LINES = np.array([[[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]], [[2.0, 0.0, 1.0], [2.0, 1.0, 1.5]]])


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    out = tmp_path_factory.mktemp("view") / "room"
    assert main(["generate", SCENE, "--out", str(out), "--frames", "3"]) == 0
    return out


def saved(path):
    """Entity path -> its chunks, as record batches."""
    out = {}
    for chunk in rerun.chunk.RrdReader(path).stream():
        out.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    return out


def column(batches, component):
    """All rows of a component, flattened."""
    values = []
    for batch in batches:
        for name in batch.schema.names:
            if name.endswith(component):
                values += [row for row in batch.column(name).to_pylist() if row is not None]
    return values


@pytest.mark.skipif(sys.platform != "linux", reason="only there a display is named so")
def test_without_a_display_no_viewer_is_started(generated, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    started = []
    monkeypatch.setattr(rerun.RecordingStream, "spawn", lambda *_, **__: started.append(1))
    assert main(["view", str(generated)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: there is no display")
    assert "--save FILE.rrd" in error
    assert not started
    monkeypatch.setenv("DISPLAY", ":0")
    assert main(["view", str(generated)]) == 0
    assert started == [1]


def test_a_sequence_is_recorded_with_frames_edges_and_true_paths(generated, tmp_path):
    out = tmp_path / "room.rrd"
    assert main(["view", str(generated), "--save", str(out)]) == 0
    found, truth = saved(out), open_sequence(generated).truth
    camera = "/world/truth/camera"
    assert {f"{camera}/rgb", f"{camera}/depth", f"{camera}/masks", "/flow",
            "/world/truth/edges"} <= found.keys()
    assert len(column(found[f"{camera}/rgb"], "buffer")) == 3
    strip, = column(found["/world/truth/camera_path/way"], "strips")
    assert_allclose(strip[0], truth.trajectories.T_world_camera[:, :3, 3], atol=1e-6)
    edges = column(found["/world/truth/edges"], "strips")
    assert [len(each) for each in edges] == [len(truth.edges(k).edge) for k in range(3)]


def run_folder(folder, source):
    folder.mkdir()
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = [0.0, 0.1, 0.25]
    (folder / "trajectory.txt").write_text(tum_lines(np.arange(3) / 10, T))
    (folder / "objects.txt").write_text("0.0 7 1 2 3 0 0 0 1\n0.1 7 1.5 2 3 0 0 0 1\n")
    (folder / "map.ply").write_text(ply_text(POINTS, LINES))
    (folder / "metrics.json").write_text('{"schema": 1}')
    (folder / "config.yaml").write_text(yaml.safe_dump({
        "source": source, "seed": 0, "frames": 3, "dials": {"texture": 0.5}}))
    return folder


def test_a_run_is_recorded_with_its_map_beside_the_truth(generated, tmp_path):
    run, out = run_folder(tmp_path / "run", SCENE), tmp_path / "run.rrd"
    assert main(["view", str(run), "--save", str(out)]) == 0
    found = saved(out)
    assert_allclose(column(found["/world/map/points"], "positions")[0], POINTS)
    assert_allclose(column(found["/world/map/lines"], "strips")[0], LINES)
    assert_allclose(column(found["/world/estimate/objects/track_7/way"], "strips")[0][0],
                    [[1, 2, 3], [1.5, 2, 3]])
    assert len(column(found["/world/truth/camera/rgb"], "buffer")) == 3     # the scene, drawn again
    # The truth's world is moved onto the estimate's: its first camera pose becomes the identity.
    shift = column(found["/world/truth"], "translation")[0][0]
    R = np.array(column(found["/world/truth"], "mat3x3")[0][0]).reshape(3, 3).T
    first = open_sequence(generated).truth.trajectories.T_world_camera[0]
    assert_allclose(se3.from_rotation_translation(R, shift) @ first, np.eye(4), atol=1e-6)


def test_a_run_on_a_recording_shows_it_when_told_where_it_is(tmp_path, capsys):
    recording = tum_folder(tmp_path / "tum")
    run, out = run_folder(tmp_path / "run", str(recording)), tmp_path / "run.rrd"
    assert main(["view", str(run), "--save", str(out)]) == 0
    assert "give --sequence DIR" in capsys.readouterr().err
    assert not any("truth" in path for path in saved(out))
    assert main(["view", str(run), "--save", str(out), "--sequence", str(recording)]) == 0
    assert "/world/truth/camera/rgb" in saved(out)


def test_a_scene_is_not_run_because_a_file_names_it(tmp_path, capsys):
    mark = tmp_path / "it_was_run"
    (tmp_path / "evil.py").write_text(f"open({str(mark)!r}, 'w')\n")
    scene = f"{tmp_path / 'evil.py'}:Evil-v0"
    run = run_folder(tmp_path / "run", scene)
    assert main(["view", str(run), "--save", str(tmp_path / "run.rrd")]) == 2
    assert f"give --scene {scene}" in capsys.readouterr().err
    assert not mark.exists()


def test_a_map_comes_back(tmp_path):
    path = tmp_path / "map.ply"
    path.write_text(ply_text(POINTS, LINES))
    points, lines = read_ply(path)
    assert_allclose(points, POINTS)
    assert_allclose(lines, LINES)
    whole = path.read_text()
    for broken in (whole.replace("edge 2", "edge 3"), whole.replace("vertex 7", "vertex 999999999"),
                   whole.replace("3 4\n", "3 99\n"), whole.replace("1.00000", "x"), "", "ply\n"):
        path.write_text(broken)
        with pytest.raises(BadFile, match=r"map\.ply"):
            read_ply(path)


@pytest.mark.parametrize(("name", "says"), [("gone/x.rrd", "there is no folder"),
                                            ("x.png", "must end in .rrd")])
def test_a_place_that_cannot_be_is_refused(generated, tmp_path, capsys, name, says):
    assert main(["view", str(generated), "--save", str(tmp_path / name)]) == 2
    assert says in capsys.readouterr().err
