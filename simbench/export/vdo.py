"""A sequence in the VDO-SLAM / SDPL-SLAM layout, metric kind (ChooseData 1)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from simbench.datasets.flo import flo_bytes
from simbench.export.target import depth_scale_for, make_folder
from simbench.sequence import Sequence
from simbench.storage import encode_depth, write_bytes, write_png
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame

_ZERO_FLOW_PX = np.float32(1e-4)      # their programs drop a feature whose flow is exactly 0
_UNKNOWN_FLOW_PX = np.float32(1e10)   # Middlebury's "unknown"
_log = logging.getLogger(__name__)


def export_vdo(sequence: Sequence, out: Path, on_frame: Callable[[], None] = lambda: None) -> None:
    """Write times, colour, depth, labels, flow, poses and settings.

    Labels are the true ids, constant in time, as the layout wants them (none without truth:
    then the recording's own masks). Flow is the true one, else the recording's; where there is
    neither, no flow/ is written and the log says so. Rows of object_pose.txt are written where
    an object is seen.

    Raises:
        UserError: the folder is not empty, or the sequence holds no depth.
        BadFrame: a frame cannot be read.
    """
    scale = depth_scale_for(sequence)
    make_folder(out)
    has_flow = "flow" in sequence.holds or (sequence.truth is not None
                                            and sequence.truth.has_images)
    if not has_flow:
        _log.warning("%s holds no flow: no flow/ is written; compute it with a program of yours",
                     sequence.name)
    for kind in ("image_0", "depth", "semantic", *(("flow",) if has_flow else ())):
        (out / kind).mkdir()
    for k in range(len(sequence)):
        frame = sequence.frame(k)
        write_png(out / "image_0" / f"{k:06d}.png", frame.rgb)
        write_png(out / "depth" / f"{k:06d}.png", encode_depth(frame.depth_m, scale))
        write_bytes(out / "semantic" / f"{k:06d}.txt", _label_bytes(_labels(sequence, frame)))
        if has_flow and k > 0:
            flow_px = _flow_to(sequence, frame)
            write_bytes(out / "flow" / f"{k - 1:06d}.flo", flo_bytes(flow_px))
        on_frame()
    _write_text(sequence, out, scale)


def _labels(sequence: Sequence, frame: Frame) -> Array:
    true = None if sequence.truth is None else sequence.truth.true_instances(frame.index)
    labels = frame.instance_id if true is None else true
    return np.zeros(frame.depth_m.shape, np.int32) if labels is None else labels


def _label_bytes(labels: Array) -> bytes:
    return b"".join(" ".join(map(str, row)).encode() + b"\n" for row in labels.tolist())


def _flow_to(sequence: Sequence, frame: Frame) -> Array:
    """(H, W, 2) float32 flow from the frame before to this one, without exact zeros."""
    truth, k = sequence.truth, frame.index
    if truth is not None and truth.has_images:
        flow = truth.flow(k - 1, k)
        flow_px = flow.flow_px
        # Behind the camera: it has a place in space, but none in this image.
        unknown = ~flow.valid & (truth.frame(k - 1).depth_m > 0)
    elif frame.flow is not None:
        flow_px = frame.flow.flow_px
        unknown = (np.zeros(flow_px.shape[:2], bool) if frame.flow.valid is None
                   else ~frame.flow.valid)
    else:
        raise AssertionError("a sequence that holds flow gives it with every frame but the first")
    filled = np.where(unknown[..., None], _UNKNOWN_FLOW_PX, flow_px)
    return np.where(filled == 0, _ZERO_FLOW_PX, filled).astype(np.float32)


def _write_text(sequence: Sequence, out: Path, scale: float) -> None:
    times = "".join(f"{stamp:.6f}\n" for stamp in sequence.stamps_s)
    write_bytes(out / "times.txt", times.encode())
    write_bytes(out / "settings.yaml", _settings(sequence, scale).encode())
    if sequence.truth is not None:
        trajectories = sequence.truth.trajectories
        write_bytes(out / "pose_gt.txt", _pose_rows(trajectories).encode())
        write_bytes(out / "object_pose.txt", _object_rows(trajectories).encode())


def _pose_rows(truth: Trajectories) -> str:
    return "".join(f"{k} " + _words(truth.T_world_camera[k].ravel()) + "\n"
                   for k in np.flatnonzero(truth.camera_valid))


def _object_rows(truth: Trajectories) -> str:
    """`k id tx ty tz rx ry rz`, T_world_object with a rotation vector, by frame, then by id."""
    rows = []
    for number, poses in truth.objects.items():
        for k in np.flatnonzero(poses.valid):
            T = poses.T_world_object[k]
            numbers = np.concatenate([T[:3, 3], se3.log_so3(T[:3, :3])])
            rows.append((int(k), number, f"{k} {number} {_words(numbers)}\n"))
    return "".join(text for _, _, text in sorted(rows))


def _words(numbers: Array) -> str:
    return " ".join(f"{x:.17g}" for x in numbers)


def _settings(sequence: Sequence, scale: float) -> str:
    i = sequence.intrinsics
    steps_s = np.diff(sequence.stamps_s)
    fps = 1.0 / float(np.median(steps_s)) if len(steps_s) else 10.0
    camera = {"fx": i.fx, "fy": i.fy, "cx": i.cx, "cy": i.cy, "k1": 0.0, "k2": 0.0, "p1": 0.0,
              "p2": 0.0, "k3": 0.0, "width": i.width, "height": i.height, "fps": fps,
              "bf": i.fx * (i.baseline_m or 0.0), "RGB": 1}
    lines = [f"Camera.{key}: {value!r}" for key, value in camera.items()]
    lines += ["ChooseData: 1", f"DepthMapFactor: {scale!r}", "ThDepthBG: 40.0", "ThDepthOBJ: 25.0"]
    return "%YAML:1.0\n" + "\n".join(lines) + "\n"
