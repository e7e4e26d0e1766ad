"""The KITTI layouts, read back by our reader, by evo and by KITTI's own formulas."""

import logging

import numpy as np
import pytest
from evo.tools import file_interface
from numpy.testing import assert_allclose, assert_array_equal

from folders import tum_folder
from simbench.export.kitti import export_kitti
from simbench.export.kitti_labels import box_corners, upright_box
from simbench.sequence import kind_of_folder, open_sequence
from slam.geometry import se3


@pytest.fixture(scope="module")
def exported(marker_sequence, tmp_path_factory):
    out = tmp_path_factory.mktemp("kitti") / "out"
    export_kitti(marker_sequence, out)
    return out


def test_stereo_images_and_camera_come_back(marker_sequence, exported):
    assert kind_of_folder(exported) == "kitti"
    read, wanted = open_sequence(exported), marker_sequence
    assert read.holds == {"stereo"}
    assert read.intrinsics.baseline_m == pytest.approx(wanted.intrinsics.baseline_m, rel=1e-9)
    assert_allclose(read.intrinsics.matrix, wanted.intrinsics.matrix, rtol=1e-11)
    assert_allclose(read.stamps_s, wanted.stamps_s, atol=1e-6)
    assert_array_equal(read.frame(3).rgb, wanted.frame(3).rgb)
    assert_array_equal(read.frame(3).right, wanted.right(3))


def test_evo_reads_the_poses_as_seen_from_the_first_camera(marker_sequence, exported):
    path = file_interface.read_kitti_poses_file(exported / "poses.txt")
    T = marker_sequence.truth.trajectories.T_world_camera
    assert_allclose(np.array(path.poses_se3), se3.inverse(T[0]) @ T, atol=1e-12)


def read_labels(path):
    """As KITTI's devkit names the columns."""
    rows = [line.split() for line in path.read_text().splitlines()]
    assert all(len(row) == 17 for row in rows)
    return [(row[2], np.array([float(x) for x in row[:2] + row[3:]])) for row in rows]


def devkit_corners(row):
    """computeBox3D of KITTI's devkit: (8, 3) corners of a 3D box in the camera's frame."""
    h, w, length, x, y, z, ry = row[9:16]
    xs = np.array([1, 1, -1, -1, 1, 1, -1, -1]) * length / 2
    ys = np.array([0, 0, 0, 0, -1, -1, -1, -1]) * h
    zs = np.array([1, -1, -1, 1, 1, -1, -1, 1]) * w / 2
    R = np.array([[np.cos(ry), 0, np.sin(ry)], [0, 1, 0], [-np.sin(ry), 0, np.cos(ry)]])
    return (R @ np.stack([xs, ys, zs])).T + np.array([x, y, z])


def test_boxes_hold_what_is_seen_of_the_objects(marker_sequence, exported):
    labels = read_labels(exported / "label_02/0000.txt")
    seen = {(k, int(i)) for k in range(6)
            for i in np.unique(marker_sequence.truth.true_instances(k)) if i}
    assert {(int(row[0]), int(row[1])) for _, row in labels} == seen
    K = marker_sequence.intrinsics.matrix
    for kind, row in labels:
        assert kind == "Misc"                    # no category is known of the room's things
        frame = marker_sequence.truth.frame(int(row[0]))
        v, u = np.nonzero(frame.instance_id == int(row[1]))
        assert_array_equal(row[5:9], [u.min(), v.min(), u.max(), v.max()])
        # Exact depth back-projected: every seen point lies in the 3D box.
        z = frame.depth_m[v, u].astype(np.float64)
        points = np.linalg.solve(K, np.stack([u * z, v * z, z])).T
        corners = devkit_corners(row)
        axes = np.stack([corners[0] - corners[3], corners[0] - corners[1],
                         corners[0] - corners[4]])
        share = (points - corners.mean(axis=0)) @ axes.T / np.sum(axes**2, axis=1)
        assert np.abs(share).max() < 0.5 + 2e-3
        assert row[4] == pytest.approx(row[15] - np.arctan2(row[12], row[14]), abs=1e-5)


def test_an_upright_box_is_the_smallest_of_its_heading():
    rng = np.random.default_rng(0)
    size, bottom, ry = np.array([1.5, 1.8, 4.2]), np.array([2.0, 1.1, 9.0]), 0.7
    corners = box_corners(ry, size, bottom)
    inside = corners.mean(axis=0) + rng.uniform(-0.5, 0.5, (50, 8)) @ (
        corners - corners.mean(axis=0)) / 8
    _, got_size, got_bottom = upright_box(np.concatenate([corners, inside]), ry)
    assert_allclose(got_size, size, atol=1e-12)
    assert_allclose(got_bottom, bottom, atol=1e-12)


def test_a_recording_has_no_labels_and_the_log_says_so(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        export_kitti(open_sequence(tum_folder(tmp_path / "t")), tmp_path / "out")
    assert "no image_3/" in caplog.text
    assert "no label_02/" in caplog.text
    assert not (tmp_path / "out/label_02").exists()
    assert not (tmp_path / "out/image_3").exists()
    assert len(open_sequence(tmp_path / "out")) == 4
