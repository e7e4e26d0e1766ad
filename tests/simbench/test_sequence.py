import pytest

from folders import kitti_folder, tum_folder, vdo_folder
from simbench.errors import BadFile
from simbench.sequence import Sequence, kind_of_folder, open_sequence


def test_the_kind_is_told_by_the_files(tmp_path):
    assert kind_of_folder(tum_folder(tmp_path / "t")) == "tum"
    assert kind_of_folder(kitti_folder(tmp_path / "k")) == "kitti"
    assert kind_of_folder(kitti_folder(tmp_path / "c", colour=True)) == "kitti"
    assert kind_of_folder(vdo_folder(tmp_path / "v", 2)) == "vdo"
    assert kind_of_folder(tmp_path) is None


@pytest.mark.parametrize("make", [tum_folder, kitti_folder, lambda f: vdo_folder(f, 1)])
def test_every_reader_keeps_the_protocol(tmp_path, make):
    sequence = open_sequence(make(tmp_path / "recording"))
    assert isinstance(sequence, Sequence)
    assert sequence.name == "recording"
    assert len(sequence.stamps_s) == len(sequence) == len(list(sequence))
    truth = sequence.truth
    assert truth.layout is None
    assert not truth.has_images
    assert truth.trajectories.T_world_camera.shape == (len(sequence), 4, 4)
    frame = sequence.frame(0)
    assert (frame.instance_id is not None) == ("masks" in sequence.holds)
    assert (frame.right is not None) == ("stereo" in sequence.holds)
    assert frame.depth_m.any() == ("depth" in sequence.holds)


def test_truth_may_be_missing(tmp_path):
    for folder, name in ((tum_folder(tmp_path / "t"), "groundtruth.txt"),
                         (kitti_folder(tmp_path / "k"), "poses.txt"),
                         (vdo_folder(tmp_path / "v", 1), "pose_gt.txt")):
        (folder / name).unlink()
        assert open_sequence(folder).truth is None


def test_a_folder_without_calibration_asks_for_it(tmp_path):
    with pytest.raises(BadFile, match=r"--calibration FILE.*width, height, fx.*depth_scale"):
        open_sequence(tum_folder(tmp_path / "t", calibration=None))


@pytest.mark.parametrize(("make", "message"), [
    (lambda p: None, "no such folder"),
    (lambda p: p.write_text(""), "is a file, not a folder"),
    (lambda p: p.mkdir(), "not a sequence of a known kind"),
])
def test_what_is_no_sequence_is_refused(tmp_path, make, message):
    make(tmp_path / "x")
    with pytest.raises(BadFile, match=message):
        open_sequence(tmp_path / "x")
