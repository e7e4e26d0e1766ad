"""What an exporter writes, our readers read back, and it is the same."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from folders import HEIGHT, WIDTH, kitti_folder, raw_depth, save, tum_folder, vdo_folder
from simbench.cli import main
from simbench.datasets.flo import flo_bytes, read_flo
from simbench.errors import UnknownName, UserError
from simbench.export import find_exporter
from simbench.export.tum import export_tum
from simbench.export.vdo import export_vdo
from simbench.sequence import open_sequence


@pytest.fixture(scope="module")
def exported(marker_sequence, tmp_path_factory):
    out = tmp_path_factory.mktemp("vdo") / "out"
    done = []
    export_vdo(marker_sequence, out, lambda: done.append(1))
    assert len(done) == len(marker_sequence)
    return out


def test_vdo_images_and_labels_come_back(marker_sequence, exported):
    read = open_sequence(exported)
    assert read.holds == {"depth", "masks", "flow"}
    assert replace(read.intrinsics, baseline_m=marker_sequence.intrinsics.baseline_m
                   ) == marker_sequence.intrinsics
    for k in (0, 2, 5):
        frame, wanted = read.frame(k), marker_sequence.frame(k)
        assert_array_equal(frame.rgb, wanted.rgb)
        assert_allclose(frame.depth_m, wanted.depth_m, atol=0.5001 / read.calibration.depth_scale)
        assert_array_equal(frame.instance_id, wanted.instance_id)


def test_vdo_flow_comes_back_and_is_nowhere_exactly_zero(marker_sequence, exported):
    read = open_sequence(exported)
    wanted = marker_sequence.truth.flow(3, 4)
    flow = read.frame(4).flow
    assert_allclose(flow.flow_px[wanted.valid], wanted.flow_px[wanted.valid], atol=1.001e-4)
    raw = np.fromfile(exported / "flow/000003.flo", "<f4", offset=12)
    assert np.all(raw != 0)
    assert not (exported / "flow/000005.flo").exists()   # there is no frame after the last


def test_vdo_poses_come_back(marker_sequence, exported):
    read, wanted = open_sequence(exported).truth.trajectories, marker_sequence.truth.trajectories
    assert_allclose(read.T_world_camera, wanted.T_world_camera, atol=1e-12)
    assert_allclose(read.stamps_s, wanted.stamps_s, atol=1e-6)
    for number, poses in wanted.objects.items():
        got = read.objects[number]
        assert_array_equal(got.valid, poses.valid)
        assert_allclose(got.T_world_object[poses.valid], poses.T_world_object[poses.valid],
                        atol=1e-12)


def test_vdo_files_are_as_their_programs_read_them(exported):
    assert (exported / "flow/000000.flo").read_bytes()[:4] == b"PIEH"
    settings = (exported / "settings.yaml").read_text()
    assert settings.startswith("%YAML:1.0\n")
    assert "ChooseData: 1\n" in settings
    assert len((exported / "semantic/000000.txt").read_text().splitlines()) == 120
    assert len((exported / "pose_gt.txt").read_text().splitlines()[3].split()) == 17
    assert len((exported / "object_pose.txt").read_text().splitlines()[0].split()) == 8


def test_tum_comes_back(marker_sequence, tmp_path):
    export_tum(marker_sequence, tmp_path / "out")
    read = open_sequence(tmp_path / "out")
    wanted = marker_sequence.frame(4)
    assert_array_equal(read.frame(4).rgb, wanted.rgb)
    assert_allclose(read.frame(4).depth_m, wanted.depth_m,
                    atol=0.5001 / read.calibration.depth_scale)
    assert_allclose(read.truth.trajectories.T_world_camera,
                    marker_sequence.truth.trajectories.T_world_camera, atol=1e-4)


def test_a_recording_keeps_its_depth_to_the_bit(tmp_path):
    source = open_sequence(tum_folder(tmp_path / "tum"))
    export_vdo(source, tmp_path / "out")
    read = open_sequence(tmp_path / "out")
    assert_array_equal(read.frame(1).depth_m, source.frame(1).depth_m)
    assert not read.frame(1).instance_id.any()
    assert not (tmp_path / "out/flow").exists()


def test_recorded_flow_and_unknown_flow_are_carried_over(tmp_path):
    folder = vdo_folder(tmp_path / "vdo", 2)
    (folder / "flow").mkdir()
    for k in range(2):
        flow = np.full((HEIGHT, WIDTH, 2), [0.0, 2.5], np.float32)
        flow[3, 3] = 1e10
        (folder / f"flow/{k:06d}.flo").write_bytes(flo_bytes(flow))
    export_vdo(open_sequence(folder), tmp_path / "out")
    got = read_flo(tmp_path / "out/flow/000001.flo", WIDTH, HEIGHT)
    assert got.flow_px[0, 0].tolist() == [np.float32(1e-4), 2.5]
    assert not got.valid[3, 3]
    # Disparity becomes metres.
    read = open_sequence(tmp_path / "out").frame(0).depth_m
    wanted = 12.0 / (raw_depth(0) / 256.0)
    near = wanted < 10.0
    assert_allclose(read[near], wanted[near], atol=1e-2)


def test_depths_beyond_16_bits_are_named_in_the_log(tmp_path, caplog):
    folder = vdo_folder(tmp_path / "vdo", 2)
    disparity = np.full((HEIGHT, WIDTH), 256 * 3, np.uint16)   # 4 m
    disparity[0, 0] = 1                                       # 3072 m
    for k in range(3):
        save(folder / f"depth/{k:06d}.png", disparity)
    export_tum(open_sequence(folder), tmp_path / "out")
    assert "depths beyond 13 m do not fit" in caplog.text
    depth_m = open_sequence(tmp_path / "out").frame(0).depth_m
    assert depth_m[0, 0] == 0
    assert_allclose(depth_m.ravel()[1:], 4.0, atol=1e-4)


def test_an_export_into_its_own_source_is_refused(tmp_path, capsys):
    source = tum_folder(tmp_path / "t")
    for out in (source, source / "copy"):
        assert main(["export", str(source), "--format", "vdo", "--out", str(out)]) == 2
        assert "outside it" in capsys.readouterr().err
    assert not (source / "copy").exists()


def test_an_export_that_fails_leaves_nothing_behind(tmp_path, capsys):
    source = tum_folder(tmp_path / "t")
    (source / "rgb/2.png").write_bytes(b"no picture")
    out = tmp_path / "out"
    assert main(["export", str(source), "--format", "tum", "--out", str(out)]) == 2
    assert "rgb/2.png" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir() if any(path.iterdir())] == ["t"]


def test_what_cannot_be_exported_is_refused(tmp_path):
    stereo = open_sequence(kitti_folder(tmp_path / "k"))
    with pytest.raises(UserError, match="holds no depth"):
        export_vdo(stereo, tmp_path / "out")
    full = tum_folder(tmp_path / "tum")
    with pytest.raises(UserError, match="not empty"):
        export_tum(open_sequence(full), full)
    with pytest.raises(UnknownName, match="there are tum, vdo, kitti, rosbag2"):
        find_exporter("bag")
    assert not Path(tmp_path / "out").exists()
