"""A rosbag2 folder, read back by rosbags: any reader that knows ROS messages and nothing of us."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from folders import tum_folder
from simbench.cli import main
from simbench.errors import UserError
from simbench.export.rosbag import export_rosbag2
from simbench.sequence import open_sequence
from simbench.storage import file_hashes
from slam.geometry import se3

highlevel = pytest.importorskip("rosbags.highlevel")


def messages(folder):
    """Topic -> [(stamp in ns, message)]."""
    out = {}
    with highlevel.AnyReader([folder]) as reader:
        for connection, stamp_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            out.setdefault(connection.topic, []).append((stamp_ns, message))
    return out


@pytest.fixture(scope="module")
def bag(marker_sequence, tmp_path_factory):
    out = tmp_path_factory.mktemp("bag") / "out"
    export_rosbag2(marker_sequence, out)
    return messages(out)


def pixels(message, dtype, channels):
    shape = (message.height, message.width, channels)[:2 + (channels > 1)]
    assert message.step == message.width * channels * np.dtype(dtype).itemsize
    assert not message.is_bigendian
    return message.data.view(dtype).reshape(shape)


def matrix(translation, rotation):
    quaternion = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    return se3.from_rotation_translation(se3.rotation_from_quaternion(quaternion),
                                         [translation.x, translation.y, translation.z])


def test_images_come_back_to_the_bit(marker_sequence, bag):
    topics = {"/camera/color/image_raw": ("rgb8", np.uint8, 3),
              "/camera/depth/image_rect": ("32FC1", np.float32, 1),
              "/camera/instance/image_raw": ("16UC1", np.uint16, 1),
              "/camera/right/image_raw": ("rgb8", np.uint8, 3)}
    for topic, (encoding, dtype, channels) in topics.items():
        assert len(bag[topic]) == 6
        for k in (0, 4):
            stamp_ns, message = bag[topic][k]
            frame = marker_sequence.frame(k)
            wanted = {"color": frame.rgb, "depth": frame.depth_m, "instance": frame.instance_id,
                      "right": frame.right}[topic.split("/")[2]]
            assert message.encoding == encoding
            assert_array_equal(pixels(message, dtype, channels), wanted)
            header = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            assert header == stamp_ns == round(frame.stamp_s * 1e9)


def test_cameras_come_back(marker_sequence, bag):
    camera = marker_sequence.intrinsics
    left, right = (bag[f"/camera/{side}/camera_info"][2][1] for side in ("color", "right"))
    assert_array_equal(left.k.reshape(3, 3), camera.matrix)
    assert (left.width, left.height) == (camera.width, camera.height)
    assert left.header.frame_id == "camera"
    # sensor_msgs/CameraInfo: Tx = −fx' B of the second camera.
    assert right.p.reshape(3, 4)[0, 3] == pytest.approx(-camera.fx * camera.baseline_m)


def test_the_tree_of_frames_leads_from_the_world_to_camera_and_objects(marker_sequence, bag):
    truth = marker_sequence.truth.trajectories
    for k, (_, message) in enumerate(bag["/tf"]):
        found = {t.child_frame_id: (t.header.frame_id, matrix(
            t.transform.translation, t.transform.rotation)) for t in message.transforms}
        wanted = {"camera": truth.T_world_camera[k]} | {
            f"object_{i}": o.T_world_object[k] for i, o in truth.objects.items() if o.valid[k]}
        parent, T_camera_right = found.pop("camera_right")
        assert parent == "camera"
        assert T_camera_right[0, 3] == marker_sequence.intrinsics.baseline_m
        assert found.keys() == wanted.keys()
        for name, (parent, T) in found.items():
            assert parent == "world"
            assert_allclose(T, wanted[name], atol=1e-12)
    _, pose = bag["/ground_truth/camera"][3]
    assert_allclose(matrix(pose.pose.position, pose.pose.orientation), truth.T_world_camera[3],
                    atol=1e-12)


def test_equal_sequences_give_equal_bytes(tmp_path, capsys):
    source = str(tum_folder(tmp_path / "t"))
    for place in ("a", "b"):
        (tmp_path / place).mkdir()
        assert main(["export", source, "--format", "rosbag2", "--out",
                     str(tmp_path / place / "bag")]) == 0
    assert file_hashes(tmp_path / "a/bag") == file_hashes(tmp_path / "b/bag")
    found = messages(tmp_path / "a/bag")
    assert "/camera/instance/image_raw" not in found        # a TUM recording has no masks
    assert len(found["/camera/depth/image_rect"]) == 4
    assert "4 frames in the rosbag2 layout" in capsys.readouterr().out


def test_what_is_missing_is_one_line(tmp_path, monkeypatch):
    source = open_sequence(tum_folder(tmp_path / "t"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install -e '\.\[rosbag\]"):
        export_rosbag2(source, tmp_path / "out")
    assert not (tmp_path / "out").exists()
