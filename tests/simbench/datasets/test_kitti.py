import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from folders import kitti_folder, picture
from simbench.errors import BadFile, BadFrame
from simbench.sequence import open_sequence


def test_grey_stereo_pairs(tmp_path):
    sequence = open_sequence(kitti_folder(tmp_path / "k"))
    assert sequence.holds == {"stereo"}
    assert sequence.intrinsics.baseline_m == pytest.approx(0.5)
    assert (sequence.intrinsics.width, sequence.intrinsics.height) == (32, 24)
    frame = sequence.frame(1)
    assert_array_equal(frame.rgb, np.repeat(picture(10, 1)[..., None], 3, axis=-1))
    assert_array_equal(frame.right[..., 0], picture(11, 1))
    assert not frame.depth_m.any()
    assert_allclose(sequence.truth.trajectories.T_world_camera[:, 2, 3], [0.0, 1.5, 3.0])


def test_colour_cameras_have_their_own_place(tmp_path):
    sequence = open_sequence(kitti_folder(tmp_path / "k", colour=True))
    assert sequence.intrinsics.baseline_m == pytest.approx(0.5)
    # P2 = K [I | t] with t = (0.1, 0, 0): camera 2's centre lies at -t in camera 0's frame.
    assert_allclose(sequence.truth.trajectories.T_world_camera[2, :3, 3], [-0.1, 0.0, 3.0])


BAD = {
    "no calibration": (lambda f: (f / "calib.txt").unlink(), "--calibration FILE.*baseline_m"),
    "short projection": (lambda f: (f / "calib.txt").write_text("P0: 1 2\n"), r"calib.txt:1: 2 co"),
    "no right camera": (lambda f: (f / "calib.txt").write_text(
        "P0: 30 0 15 0 0 30 11 0 0 0 1 0\n"), "no row P1"),
    "too few poses": (lambda f: (f / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n"),
                      "1 poses for the 3 frames"),
    "no rotation": (lambda f: (f / "poses.txt").write_text("2 0 0 0 0 1 0 0 0 0 1 0\n" * 3),
                    "rotation of pose 1 is not a rotation"),
    "no images": (lambda f: [p.unlink() for p in (f / "image_0").iterdir()], "no image that can"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_folder_is_named_in_one_line(tmp_path, case):
    spoil, message = BAD[case]
    folder = kitti_folder(tmp_path / "k")
    spoil(folder)
    with pytest.raises(BadFile, match=message) as caught:
        open_sequence(folder)
    assert "\n" not in str(caught.value)


def test_a_missing_right_image_is_a_bad_frame(tmp_path):
    folder = kitti_folder(tmp_path / "k")
    (folder / "image_1/000002.png").unlink()
    sequence = open_sequence(folder)
    assert sequence.frame(1).right is not None
    with pytest.raises(BadFrame, match=r"image_1/000002\.png"):
        sequence.frame(2)


def test_a_given_calibration_stands_in_for_calib_txt(tmp_path):
    folder = kitti_folder(tmp_path / "k")
    (folder / "calib.txt").unlink()
    given = tmp_path / "calibration.yaml"
    given.write_text("width: 32\nheight: 24\nfx: 20\nfy: 20\ncx: 15\ncy: 11\nbaseline_m: 0.4\n")
    sequence = open_sequence(folder, given)
    assert (sequence.intrinsics.fx, sequence.intrinsics.baseline_m) == (20.0, 0.4)
    assert sequence.frame(0).right is not None
