import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from simbench.errors import BadFile
from simbench.trajectory_files import (
    read_kitti_poses,
    read_tum_trajectory,
    write_kitti_poses,
    write_tum_trajectory,
)
from synthetic import smooth_poses


def test_round_trips_lose_nothing(tmp_path):
    T = smooth_poses(20, np.random.default_rng(0))
    write_tum_trajectory(tmp_path / "t.txt", np.arange(20) / 8, T)
    stamps_s, got = read_tum_trajectory(tmp_path / "t.txt")
    assert_array_equal(stamps_s, np.arange(20) / 8)
    assert_allclose(got, T, atol=1e-14)
    write_kitti_poses(tmp_path / "k.txt", T)
    assert_allclose(read_kitti_poses(tmp_path / "k.txt"), T, atol=1e-14)


def test_rows_are_sorted_and_quaternions_normalised(tmp_path):
    (tmp_path / "t.txt").write_text("# c\n2 0 0 0 0 0 0 3\n\n1,5,0,0,0,0,2,2 # turned\n")
    stamps_s, T = read_tum_trajectory(tmp_path / "t.txt")
    assert stamps_s.tolist() == [1.0, 2.0]
    assert_allclose(T[0], [[0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-15)


def test_an_empty_trajectory_has_no_poses(tmp_path):
    (tmp_path / "t.txt").write_text("# nothing\n")
    stamps_s, T = read_tum_trajectory(tmp_path / "t.txt")
    assert (stamps_s.shape, T.shape) == ((0,), (0, 4, 4))


@pytest.mark.parametrize(("text", "message"), [
    ("1 0 0 0 0 0 0 1\n2 0 0\n", r"t\.txt:2: 3 columns, wanted 8"),
    ("1 0 0 0 0 0 0 1\n\n2 0 0 0 0 0 0 one\n", r"t\.txt:3: .*'one'"),
    ("1 0 inf 0 0 0 0 1\n", r"t\.txt:1: .*not finite"),
    ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", r"stamp 1\.000000 stands twice"),
])
def test_a_broken_row_is_named_by_its_line(tmp_path, text, message):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(BadFile, match=message) as caught:
        read_tum_trajectory(tmp_path / "t.txt")
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "t.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadFile, match="not a text file"):
        read_tum_trajectory(tmp_path / "t.txt")
    with pytest.raises(BadFile, match="no such file"):
        read_tum_trajectory(tmp_path / "none.txt")
