import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from folders import CALIBRATION, picture, raw_depth, save, tum_folder
from simbench.datasets.tum import associate, interpolate_poses
from simbench.errors import BadFile, BadFrame
from simbench.sequence import open_sequence
from slam.geometry import se3


def test_frames_are_pairs_of_colour_and_depth(tmp_path):
    sequence = open_sequence(tum_folder(tmp_path / "tum"))
    assert len(sequence) == 4
    assert sequence.holds == {"depth"}
    frame = sequence.frame(2)
    assert frame.stamp_s == pytest.approx(100.2)
    assert_array_equal(frame.rgb, picture(2)[..., ::-1])
    assert_allclose(frame.depth_m, raw_depth(2) / 5000.0, rtol=1e-6)
    assert [f.index for f in sequence] == [0, 1, 2, 3]
    with pytest.raises(IndexError):
        sequence.frame(4)


def test_truth_lies_between_the_poses_around_each_stamp(tmp_path):
    truth = open_sequence(tum_folder(tmp_path / "tum")).truth.trajectories
    assert truth.camera_valid.all()
    t = np.arange(4) / 10
    assert_allclose(truth.T_world_camera[:, 0, 3], t, atol=1e-6)
    assert_allclose(se3.log_so3(truth.T_world_camera[:, :3, :3])[:, 2], t, atol=1e-6)
    assert truth.objects == {}


def test_a_gap_in_the_truth_leaves_a_pose_unknown():
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = [0.0, 1.0, 2.0]
    got, known = interpolate_poses(np.array([-0.01, 0.0, 0.03, 0.5, 1.06, 1.08]),
                                   np.array([0.0, 1.04, 1.08]), T)
    assert known.tolist() == [False, True, False, False, True, True]
    assert_allclose(got[known, 0, 3], [0.0, 1.5, 2.0])


def test_association_takes_each_image_once():
    rgb, depth = associate(np.array([0.0, 0.01, 0.1, 0.2]), np.array([0.012, 0.115, 0.3]), 0.02)
    assert rgb.tolist() == [1, 2]
    assert depth.tolist() == [0, 1]
    assert associate(np.array([1.0]), np.array([1.001]), 0.02)[0].tolist() == [0]


def test_images_without_a_partner_are_named_in_the_log(tmp_path, caplog):
    folder = tum_folder(tmp_path / "tum")
    rows = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join(rows[:-1]) + "\n")
    assert len(open_sequence(folder)) == 3
    assert "1 of 4 colour images have no depth image" in caplog.text


def test_undistorted_pixels_are_those_of_the_pinhole_camera(tmp_path):
    distorted = CALIBRATION.replace("[0, 0, 0, 0, 0]", "[-0.4, 0.1, 0.01, -0.01, 0.0]")
    folder = tum_folder(tmp_path / "tum", calibration=distorted)
    K = np.array([[30.0, 0, 15.5], [0, 31.0, 11.5], [0, 0, 1]])
    u, v = 4, 4   # where a pinhole camera of this K sees the ray, the lens sees it elsewhere
    ray = np.linalg.inv(K) @ [u, v, 1.0]
    at = cv2.projectPoints(ray[None], np.zeros(3), np.zeros(3), K,
                           np.array([-0.4, 0.1, 0.01, -0.01, 0.0]))[0].ravel()
    row, column = np.rint(at[::-1]).astype(int)
    assert (row, column) != (v, u)
    frame = open_sequence(folder).frame(0)
    assert frame.depth_m[v, u] == pytest.approx(raw_depth(0)[row, column] / 5000.0, rel=1e-6)
    low = picture(0)[..., ::-1][int(at[1]):int(at[1]) + 2, int(at[0]):int(at[0]) + 2]
    assert np.all(frame.rgb[v, u] >= low.min(axis=(0, 1)) - 1)
    assert np.all(frame.rgb[v, u] <= low.max(axis=(0, 1)) + 1)


def test_65535_is_no_measurement(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    depth = raw_depth(0)
    depth[3, 4] = 65535
    save(folder / "depth/0.png", depth)
    got = open_sequence(folder).frame(0).depth_m
    assert got[3, 4] == 0
    assert np.count_nonzero(got == 0) == 1


def _cut(path):
    path.write_bytes(path.read_bytes()[:-40])


BAD_FRAMES = {
    "missing colour": (lambda f: (f / "rgb/1.png").unlink(), "rgb/1.png: no such image"),
    "truncated colour": (lambda f: _cut(f / "rgb/1.png"), "rgb/1.png: the image is truncated"),
    "empty depth": (lambda f: (f / "depth/1.png").write_bytes(b""), "depth/1.png: the image is"),
    "text as image": (lambda f: (f / "rgb/1.png").write_text("hello"), "not an image"),
    "depth of another size": (lambda f: save(f / "depth/1.png", np.ones((5, 6), np.uint16)),
                              "depth/1.png: 6×5 pixels, the calibration says 32×24"),
    "depth of 8 bits": (lambda f: save(f / "depth/1.png", np.ones((24, 32), np.uint8)),
                        "wanted one 16-bit channel"),
}


@pytest.mark.parametrize("case", BAD_FRAMES)
def test_a_bad_image_is_a_bad_frame_and_the_others_are_read(tmp_path, case):
    spoil, message = BAD_FRAMES[case]
    folder = tum_folder(tmp_path / "tum")
    spoil(folder)
    sequence = open_sequence(folder)
    with pytest.raises(BadFrame, match=message) as caught:
        sequence.frame(1)
    assert "\n" not in str(caught.value)
    assert sequence.frame(0).index == 0
    assert sequence.frame(2).index == 2


BAD_FILES = {
    "short truth row": ("groundtruth.txt", "1 2 3\n", r"groundtruth.txt:1: 3 columns, wanted 8"),
    "word in truth": ("groundtruth.txt", "# t\n1 2 3 x 0 0 0 1\n", r"groundtruth.txt:2: .*'x'"),
    "nan in truth": ("groundtruth.txt", "1 2 3 nan 0 0 0 1\n", r"groundtruth.txt:1: .*not finite"),
    "zero quaternion": ("groundtruth.txt", "1 2 3 4 0 0 0 0\n", "quaternion of pose 1 is zero"),
    "list row without a file": ("rgb.txt", "100.0\n", r"rgb.txt:1: 1 columns, wanted 2"),
    "stamps out of order": ("rgb.txt", "2 a.png\n1 b.png\n", "not later than the one before"),
    "empty list": ("depth.txt", "# nothing\n", "no rows in it"),
    "broken calibration": ("calibration.yaml", "width: [\n", "not YAML"),
    "key missing": ("calibration.yaml", "width: 3\n", "key 'height' is missing"),
    "unknown key": ("calibration.yaml", CALIBRATION + "fz: 1\n", "unknown key 'fz'"),
    "word as number": ("calibration.yaml", CALIBRATION.replace("30.0", "wide"), "fx is 'wide'"),
    "negative focal length": ("calibration.yaml", CALIBRATION.replace("30.0", "-3"),
                              "fx is -3.0; it must be above 0"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_text_file_is_named_in_one_line(tmp_path, case):
    name, text, message = BAD_FILES[case]
    folder = tum_folder(tmp_path / "tum")
    (folder / name).write_text(text)
    with pytest.raises(BadFile, match=message) as caught:
        open_sequence(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_the_fingerprint_follows_the_content(tmp_path):
    folder = tum_folder(tmp_path / "tum")
    before = open_sequence(folder).fingerprint()
    assert open_sequence(folder).fingerprint() == before
    (folder / "groundtruth.txt").write_text("100 0 0 0 0 0 0 1\n")
    assert open_sequence(folder).fingerprint() != before
