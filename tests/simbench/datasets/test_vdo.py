import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from folders import HEIGHT, WIDTH, raw_depth, save, vdo_folder
from simbench.datasets.flo import flo_bytes
from simbench.errors import BadFile, BadFrame, UserError
from simbench.sequence import open_sequence
from slam.geometry import se3


def test_depth_of_the_metric_kind_is_metres_and_of_the_kitti_kind_disparity(tmp_path):
    metric = open_sequence(vdo_folder(tmp_path / "m", 1)).frame(1)
    assert_allclose(metric.depth_m, raw_depth(1) / 5000.0, rtol=1e-6)
    kitti = open_sequence(vdo_folder(tmp_path / "k", 2)).frame(1)
    assert_allclose(kitti.depth_m, 12.0 / (raw_depth(1) / 256.0), rtol=1e-6)


def test_disparities_that_mean_nothing_are_no_depth(tmp_path):
    folder = vdo_folder(tmp_path / "k", 2)
    disparity = raw_depth(0)
    disparity[0, :2] = 0, 65535
    save(folder / "depth/000000.png", disparity)
    depth_m = open_sequence(folder).frame(0).depth_m
    assert depth_m[0, :2].tolist() == [0.0, 0.0]
    assert np.all(depth_m.ravel()[2:] > 0)


def test_object_rows_of_the_kitti_kind_are_in_the_camera(tmp_path):
    truth = open_sequence(vdo_folder(tmp_path / "k", 2)).truth.trajectories
    T = truth.objects[7].T_world_object[2]
    assert_allclose(T[:3, 3], [1.0, 2.0, 11.0])   # the camera stands at z = 2
    # The car's x axis points where KITTI's yaw says, turned by a quarter: R_y(0.25 + π/2) e_x.
    angle = 0.25 + np.pi / 2
    assert_allclose(T[:3, 0], [np.cos(angle), 0.0, -np.sin(angle)], atol=1e-12)


def test_object_rows_of_the_metric_kind_are_in_the_world(tmp_path):
    truth = open_sequence(vdo_folder(tmp_path / "m", 1)).truth.trajectories
    T = truth.objects[7].T_world_object[2]
    assert_allclose(T[:3, 3], [1.0, 2.0, 9.0])
    assert_allclose(se3.log_so3(T[:3, :3]), [0.0, 0.0, 0.5], atol=1e-12)


def test_an_object_is_valid_where_a_row_and_a_mask_are_there(tmp_path):
    folder = vdo_folder(tmp_path / "m", 1)
    rows = (folder / "object_pose.txt").read_text().splitlines()
    (folder / "object_pose.txt").write_text("\n".join(r for r in rows if r[:3] != "1 7") + "\n")
    objects = open_sequence(folder).truth.trajectories.objects
    assert objects[7].valid.tolist() == [True, False, True]
    assert objects[8].valid.tolist() == [False, False, True]


def test_the_labels_are_the_true_ids(tmp_path):
    sequence = open_sequence(vdo_folder(tmp_path / "m", 1))
    assert_array_equal(sequence.truth.true_instances(2), sequence.frame(2).instance_id)
    assert sequence.frame(2).instance_id[11, 21] == 8
    assert sequence.holds == {"depth", "masks"}
    with pytest.raises(UserError, match="no true flow"):
        sequence.truth.flow(0, 1)


def test_flow_file_k_minus_1_belongs_to_frame_k(tmp_path):
    folder = vdo_folder(tmp_path / "m", 1)
    (folder / "flow").mkdir()
    for k in range(2):
        flow = np.full((HEIGHT, WIDTH, 2), 10.0 + k, np.float32)
        flow[0, 0] = 1e10
        (folder / f"flow/{k:06d}.flo").write_bytes(flo_bytes(flow))
    sequence = open_sequence(folder)
    assert "flow" in sequence.holds
    assert sequence.frame(0).flow is None
    assert sequence.frame(1).flow.flow_px[5, 5].tolist() == [10.0, 10.0]
    assert sequence.frame(2).flow.flow_px[5, 5].tolist() == [11.0, 11.0]
    assert not sequence.frame(1).flow.valid[0, 0]
    assert np.count_nonzero(sequence.frame(1).flow.valid) == HEIGHT * WIDTH - 1


def _spoil_flow(folder, data):
    (folder / "flow").mkdir()
    (folder / "flow/000000.flo").write_bytes(data)


WHOLE = flo_bytes(np.zeros((HEIGHT, WIDTH, 2)))
BAD_FRAMES = {
    "short mask": (lambda f: (f / "semantic/000001.txt").write_text("0 0 0\n"),
                   "3 labels, the calibration says 32×24 = 768"),
    "word in mask": (lambda f: (f / "semantic/000001.txt").write_text("0 x 0\n"), "not an integer"),
    "missing mask": (lambda f: (f / "semantic/000001.txt").unlink(), "no such mask file"),
    "truncated flow": (lambda f: _spoil_flow(f, WHOLE[:-1]), "flow file is truncated"),
    "flow of another size": (lambda f: _spoil_flow(f, flo_bytes(np.zeros((3, 4, 2)))), "4×3"),
    "no flow file": (lambda f: _spoil_flow(f, b"PIEHx"), "not a Middlebury"),
}


@pytest.mark.parametrize("case", BAD_FRAMES)
def test_a_bad_file_of_a_frame_is_a_bad_frame(tmp_path, case):
    spoil, message = BAD_FRAMES[case]
    folder = vdo_folder(tmp_path / "m", 1)
    spoil(folder)
    sequence = open_sequence(folder)
    with pytest.raises(BadFrame, match=message):
        sequence.frame(1)
    assert sequence.frame(0).index == 0


def test_a_frame_whose_mask_cannot_be_read_shows_no_object(tmp_path):
    folder = vdo_folder(tmp_path / "m", 1)
    (folder / "semantic/000001.txt").unlink()
    objects = open_sequence(folder).truth.trajectories.objects
    assert objects[7].valid.tolist() == [True, False, True]


BAD_FILES = {
    "frame beyond the end": ("object_pose.txt", "9 7 1 2 3 0 0 0\n", "a row is of frame 9"),
    "short object row": ("object_pose.txt", "0 7 1 2 3\n", r"object_pose.txt:1: 5 columns"),
    "short pose": ("pose_gt.txt", "0 1 0 0\n", r"pose_gt.txt:1: 4 columns"),
    "kind 3": ("settings.yaml", "ChooseData: 3\n", "ChooseData is 3"),
    "no kind": ("settings.yaml", "Camera.fx: 3\n", "key ChooseData is missing"),
    "stamps that stand still": ("times.txt", "0\n0\n1\n", "not later than"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_text_file_is_named_in_one_line(tmp_path, case):
    name, text, message = BAD_FILES[case]
    folder = vdo_folder(tmp_path / "m", 1)
    (folder / name).write_text(text)
    with pytest.raises(BadFile, match=message) as caught:
        _ = open_sequence(folder).truth.trajectories
    assert "\n" not in str(caught.value)


def test_without_settings_a_calibration_is_asked_for_and_then_metric(tmp_path):
    folder = vdo_folder(tmp_path / "m", 1)
    (folder / "settings.yaml").unlink()
    with pytest.raises(BadFile, match=r"--calibration FILE.*fx, fy, cx, cy"):
        open_sequence(folder)
    given = tmp_path / "c.yaml"
    given.write_text("width: 32\nheight: 24\nfx: 20\nfy: 20\ncx: 15\ncy: 11\ndepth_scale: 1000\n")
    assert_allclose(open_sequence(folder, given).frame(0).depth_m, raw_depth(0) / 1000, rtol=1e-6)
