"""A sequence as a rosbag2 folder (MCAP), written without ROS."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from simbench.errors import UserError
from simbench.export.target import make_folder
from simbench.extras import how_to_install
from simbench.sequence import Sequence
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics

_WORLD, _CAMERA, _RIGHT = "world", "camera", "camera_right"
_BAG_VERSION: Literal[9] = 9     # as ROS 2 Jazzy writes it
_TOPICS = {              # topic: type; depth in float32 metres, as REP 118 has it
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/camera/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/image_rect": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/instance/image_raw": "sensor_msgs/msg/Image",
    "/camera/right/image_raw": "sensor_msgs/msg/Image",
    "/camera/right/camera_info": "sensor_msgs/msg/CameraInfo",
    "/ground_truth/camera": "geometry_msgs/msg/PoseStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
}


def export_rosbag2(sequence: Sequence, out: Path,
                   on_frame: Callable[[], None] = lambda: None) -> None:
    """Write metadata.yaml and one .mcap file.

    Colour (rgb8), depth (32FC1, metres), masks (16UC1) and right images with their camera_info;
    true poses on /tf from `world` to `camera` (optical axes: x right, y down, z forward) and to
    each object (`object_1`, …), the camera's on /ground_truth/camera as well. A topic that the
    sequence has nothing for is not in the bag.

    Raises:
        UserError: the folder is not empty, a stamp is negative, or rosbags is not installed.
        BadFrame: a frame cannot be read.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise UserError(f"--format rosbag2: needs rosbags; {how_to_install('rosbag')}")
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415 (an optional extra)
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    if sequence.stamps_s[0] < 0:
        raise UserError(f"{sequence.name}: its first stamp is {sequence.stamps_s[0]:.3f} s, which "
                        "a bag cannot hold; shift the stamps to start at 0 or later")
    make_folder(out)
    out.rmdir()              # the writer makes it itself
    store = get_typestore(Stores.ROS2_JAZZY)
    messages = _Messages(store.types, sequence.intrinsics)
    truth = None if sequence.truth is None else sequence.truth.trajectories
    with Writer(out, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Any] = {}
        for k in range(len(sequence)):
            frame = sequence.frame(k)
            stamp_ns = round(frame.stamp_s * 1e9)
            for topic, message in messages.of_frame(frame, truth, sequence.holds):
                kind = _TOPICS[topic]
                if topic not in connections:
                    connections[topic] = bag.add_connection(topic, kind, typestore=store)
                bag.write(connections[topic], stamp_ns, store.serialize_cdr(message, kind))
            on_frame()


class _Messages:
    """Frames and poses as ROS messages."""

    def __init__(self, types: Mapping[str, Any], intrinsics: Intrinsics) -> None:
        self._types, self._intrinsics = types, intrinsics

    def of_frame(self, frame: Frame, truth: Trajectories | None, holds: frozenset[str]
                 ) -> Iterator[tuple[str, Any]]:
        """Topics and messages of one instant."""
        stamp = self._stamp(frame.stamp_s)
        camera, right = self._make("Header", stamp, _CAMERA), self._make("Header", stamp, _RIGHT)
        if truth is not None:
            yield from self._poses(truth, frame.index, stamp)
        yield "/camera/color/image_raw", self._image(camera, "rgb8", frame.rgb)
        yield "/camera/color/camera_info", self._info(camera, 0.0)
        if "depth" in holds:
            yield "/camera/depth/image_rect", self._image(camera, "32FC1", frame.depth_m)
            yield "/camera/depth/camera_info", self._info(camera, 0.0)
        if frame.instance_id is not None:
            labels = frame.instance_id.astype(np.uint16)
            yield "/camera/instance/image_raw", self._image(camera, "16UC1", labels)
        if frame.right is not None:
            yield "/camera/right/image_raw", self._image(right, "rgb8", frame.right)
            yield "/camera/right/camera_info", self._info(
                right, self._intrinsics.baseline_m or 0.0)

    def _poses(self, truth: Trajectories, k: int, stamp: Any) -> Iterator[tuple[str, Any]]:
        world = self._make("Header", stamp, _WORLD)
        poses = {_CAMERA: truth.T_world_camera[k]} if truth.camera_valid[k] else {}
        poses |= {f"object_{number}": each.T_world_object[k]
                  for number, each in truth.objects.items() if each.valid[k]}
        transforms = [self._make("TransformStamped", world, name, self._make(
            "Transform", *self._place("Vector3", T))) for name, T in poses.items()]
        if self._intrinsics.baseline_m:
            aside = np.eye(4)
            aside[0, 3] = self._intrinsics.baseline_m
            transforms.append(self._make(
                "TransformStamped", self._make("Header", stamp, _CAMERA), _RIGHT,
                self._make("Transform", *self._place("Vector3", aside))))
        if transforms:
            yield "/tf", self._make("TFMessage", transforms)
        if truth.camera_valid[k]:
            pose = self._make("Pose", *self._place("Point", truth.T_world_camera[k]))
            yield "/ground_truth/camera", self._make("PoseStamped", world, pose)

    def _place(self, position: str, T: Array) -> tuple[Any, Any]:
        quaternion_xyzw = se3.quaternion_from_rotation(T[:3, :3])
        return (self._make(position, *(float(x) for x in T[:3, 3])),
                self._make("Quaternion", *(float(x) for x in quaternion_xyzw)))

    def _image(self, header: Any, encoding: str, pixels: Array) -> Any:
        data = np.ascontiguousarray(pixels)
        height, width = data.shape[:2]
        return self._make("Image", header, height, width, encoding, 0, data.strides[0],
                          np.frombuffer(data.tobytes(), np.uint8))

    def _info(self, header: Any, baseline_m: float) -> Any:
        """The right camera's projection holds −fx · baseline, as ROS has it."""
        i = self._intrinsics
        P = np.zeros((3, 4))
        P[:, :3] = i.matrix
        P[0, 3] = -i.fx * baseline_m
        everywhere = self._make("RegionOfInterest", 0, 0, 0, 0, False)
        return self._make("CameraInfo", header, i.height, i.width, "plumb_bob", np.zeros(5),
                          i.matrix.ravel(), np.eye(3).ravel(), P.ravel(), 0, 0, everywhere)

    def _stamp(self, stamp_s: float) -> Any:
        seconds, nanoseconds = divmod(round(stamp_s * 1e9), 10**9)
        return self._make("Time", seconds, nanoseconds)

    def _make(self, name: str, *fields: Any) -> Any:
        return self._types[_PACKAGE_OF[name] + name](*fields)


_PACKAGE_OF = {
    "Time": "builtin_interfaces/msg/", "Header": "std_msgs/msg/", "TFMessage": "tf2_msgs/msg/",
    **dict.fromkeys(("Image", "CameraInfo", "RegionOfInterest"), "sensor_msgs/msg/"),
    **dict.fromkeys(("Point", "Vector3", "Quaternion", "Pose", "PoseStamped", "Transform",
                     "TransformStamped"), "geometry_msgs/msg/"),
}
