"""ORB-SLAM3 itself as a system, to stand beside ours in every table.

    pip install -e '.[orbslam3]'
    simbench run SwingingBoxes-v0 --system examples/orbslam3_system.py:make --out run

The wheel `pyorbslam3` is under the GPL-3: nothing of this project imports it but this file, which
you run by your own choice. ORB-SLAM3's own vocabulary is large and not ours to ship; it is given
that of `dpl` (scripts/train_vocabulary.py) in its own format. Its threads run as they like: runs of
equal input differ by some percent, and more where its mapping gets too little of the processors.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from simbench.errors import UserError
from simbench.extras import how_to_install
from simbench.trajectory_files import read_tum_trajectory
from slam.dpl.vocabulary import Vocabulary, shipped
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult, Status

POINTS = 1000
FAR_BASELINES = 40.0        # stereo points within so many baselines count as near (its ThDepth)
RGBD_BASELINE_M = 0.08      # of the virtual right camera that its RGB-D mode thinks of
FRAMES_A_SECOND = 30.0      # it bounds how long it waits for a new keyframe


def make(intrinsics: Intrinsics) -> OrbSlam3:
    """A fresh ORB-SLAM3: stereo where frames have a right image, RGB-D otherwise."""
    return OrbSlam3(intrinsics)


class OrbSlam3:
    """`process` gives the pose of its tracking, `finish` the trajectory after all corrections."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self._library = _library()
        self._intrinsics = intrinsics
        self._folder = Path(tempfile.mkdtemp(prefix="orbslam3-"))
        atexit.register(shutil.rmtree, self._folder, ignore_errors=True)
        self._slam: Any = None
        self._stereo = False
        self._stamps: list[float] = []
        self._T_world_map = np.eye(4)       # a lost map is followed by a new one, begun anew
        self._last: Array | None = None     # T_world_camera of the frame before, if it had one
        self._known = np.eye(4)             # the last pose there was

    def process(self, frame: Frame) -> FrameEstimate:
        """One frame through its tracking thread."""
        if self._slam is None:
            self._start(frame)
        self._stamps.append(frame.stamp_s)
        with _silent():
            found = self._track(frame)
        if not found.pose_valid:
            self._last = None
            return FrameEstimate(frame.index, frame.stamp_s, self._known, np.eye(4),
                                 status=Status.LOST, reason=f"ORB-SLAM3: {found.state.name}")
        T_map_camera = se3.orthonormalised(np.asarray(found.pose_wc, np.float64))
        first = self._last is None and np.array_equal(T_map_camera, np.eye(4))
        if first:
            self._T_world_map = self._known     # a new map begins where the last pose was
        T = self._T_world_map @ T_map_camera
        step = np.eye(4) if self._last is None else se3.inverse(self._last) @ T
        status = Status.FIRST if self._last is None else Status.TRACKED
        self._last = self._known = T
        return FrameEstimate(frame.index, frame.stamp_s, T, step, status=status,
                             inliers={"points": int(found.num_tracked_points)})

    def finish(self) -> SlamResult:
        """Stop its threads; every frame's pose after bundle adjustment and loop closing."""
        poses = np.broadcast_to(np.eye(4), (len(self._stamps), 4, 4)).copy()
        status = [Status.LOST] * len(self._stamps)
        if self._slam is not None:
            with _silent():
                self._slam.shutdown()
            if self._last is not None or not np.array_equal(self._known, np.eye(4)):
                for k, T in self._saved():
                    poses[k], status[k] = T, Status.TRACKED
        return SlamResult(np.array(self._stamps), poses, {}, tuple(status))

    def _saved(self) -> Iterator[tuple[int, Array]]:
        path = self._folder / "trajectory.txt"
        with _silent():
            self._slam.save_trajectory_tum(str(path))
        stamps, T = read_tum_trajectory(path)
        for stamp, pose in zip(stamps, T, strict=True):
            k = int(np.argmin(np.abs(np.array(self._stamps) - stamp)))
            yield k, pose

    def _track(self, frame: Frame) -> Any:
        rgb = np.ascontiguousarray(frame.rgb)
        if self._stereo:
            return self._slam.track_stereo(rgb, np.ascontiguousarray(frame.right), frame.stamp_s)
        return self._slam.track_rgbd(rgb, np.ascontiguousarray(frame.depth_m, np.float32),
                                     frame.stamp_s)

    def _start(self, frame: Frame) -> None:
        self._stereo = frame.right is not None and self._intrinsics.baseline_m is not None
        if not self._stereo and frame.depth_m is None:
            raise UserError("ORB-SLAM3 as it is used here needs depth or a right image; "
                            "give --depth sensor or a stereo sequence")
        vocabulary, settings = self._folder / "vocabulary.txt", self._folder / "settings.yaml"
        vocabulary.write_text(vocabulary_text(shipped()))
        settings.write_text(settings_text(self._intrinsics, self._stereo))
        sensor = self._library.Sensor
        mode = sensor.STEREO if self._stereo else sensor.RGBD
        with _silent():
            self._slam = self._library.Slam(vocabulary, settings, mode)


def _library() -> ModuleType:
    try:
        import pyorbslam3  # noqa: PLC0415 (the rest of this file is of use without it)
    except ModuleNotFoundError:
        raise UserError("examples/orbslam3_system.py: pyorbslam3 is not installed "
                        f"(GPL-3, Linux x86-64); {how_to_install('orbslam3')}") from None
    return pyorbslam3


def settings_text(camera: Intrinsics, stereo: bool) -> str:
    """Its settings file: a pinhole camera without distortion, rectified where there are two.

    The older of its two layouts: with the newer it crashes on rectified pairs.
    """
    baseline_m = camera.baseline_m if stereo else RGBD_BASELINE_M
    numbers = {"Camera.fx": camera.fx, "Camera.fy": camera.fy, "Camera.cx": camera.cx,
               "Camera.cy": camera.cy, "Camera.k1": 0.0, "Camera.k2": 0.0, "Camera.p1": 0.0,
               "Camera.p2": 0.0, "Camera.bf": camera.fx * baseline_m, "Camera.fps": FRAMES_A_SECOND,
               "ThDepth": FAR_BASELINES, "DepthMapFactor": 1.0, "ORBextractor.scaleFactor": 1.2,
               # It wants to know how to draw even where nothing is drawn.
               "Viewer.KeyFrameSize": 0.05, "Viewer.KeyFrameLineWidth": 1.0,
               "Viewer.GraphLineWidth": 0.9, "Viewer.PointSize": 2.0, "Viewer.CameraSize": 0.08,
               "Viewer.CameraLineWidth": 3.0, "Viewer.ViewpointX": 0.0, "Viewer.ViewpointY": -0.7,
               "Viewer.ViewpointZ": -1.8, "Viewer.ViewpointF": 500.0}
    counts = {"Camera.width": camera.width, "Camera.height": camera.height, "Camera.RGB": 1,
              "ORBextractor.nFeatures": POINTS, "ORBextractor.nLevels": 8,
              "ORBextractor.iniThFAST": 20, "ORBextractor.minThFAST": 7}
    lines = ["%YAML:1.0", 'Camera.type: "PinHole"',
             *(f"{name}: {float(value)!r}" for name, value in numbers.items()),
             *(f"{name}: {value}" for name, value in counts.items())]
    return "\n".join(lines) + "\n"


def vocabulary_text(vocabulary: Vocabulary) -> str:
    """A tree of words as DBoW2 reads it.

    The first line says branching, levels, scoring (0: L1) and weighting (0: tf-idf); then one node
    a line, parents first: its parent's number, 1 for a leaf, 32 bytes, the weight. No line may be
    empty.
    """
    k = vocabulary.branching
    nodes, words = len(vocabulary.centre), len(vocabulary.idf)
    levels = round(np.log(words) / np.log(k))
    starts = np.cumsum([0, *(k ** level for level in range(1, levels + 1))])
    level = np.searchsorted(starts, np.arange(nodes), side="right") - 1
    within = np.arange(nodes) - starts[level]
    # Node i of the file has the number i + 1; 0 is the root.
    parent = np.where(level == 0, 0, starts[np.maximum(level - 1, 0)] + within // k + 1)
    leaf = level == levels - 1
    weight = np.where(leaf, vocabulary.idf[np.where(leaf, within, 0)], 0.0)
    octets = np.ascontiguousarray(vocabulary.centre).view(np.uint8).reshape(nodes, 32)
    lines = [f"{k} {levels} 0 0"]
    lines += [f"{p} {int(is_leaf)} {' '.join(map(str, row))} {w:.6g}"
              for p, is_leaf, row, w in zip(parent, leaf, octets.tolist(), weight, strict=True)]
    return "\n".join(lines)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Its library prints its settings and much more, below Python; what is wrong it raises."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept, null = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    try:
        yield
    finally:
        for number, copy in enumerate(kept, start=1):
            os.dup2(copy, number)
            os.close(copy)
        os.close(null)
