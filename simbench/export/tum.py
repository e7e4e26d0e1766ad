"""A sequence as a TUM RGB-D folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from simbench import storage
from simbench.export.target import depth_scale_for, make_folder
from simbench.sequence import Sequence


def export_tum(sequence: Sequence, out: Path, on_frame: Callable[[], None] = lambda: None) -> None:
    """Write rgb/, depth/, their lists, groundtruth.txt and calibration.yaml.

    Raises:
        UserError: the folder is not empty, or the sequence holds no depth.
        BadFrame: a frame cannot be read.
    """
    scale = depth_scale_for(sequence)
    make_folder(out)
    for kind in ("rgb", "depth"):
        (out / kind).mkdir()
    storage.write_calibration(out, sequence.intrinsics, scale, None)
    truth = None if sequence.truth is None else sequence.truth.trajectories
    if truth is None:
        storage.write_lists(out, sequence.stamps_s, None)
    else:
        storage.write_lists(out, sequence.stamps_s, truth.T_world_camera, truth.camera_valid)
    for k in range(len(sequence)):
        frame = sequence.frame(k)
        storage.write_png(storage.image_path(out, "rgb", k), frame.rgb)
        storage.write_png(storage.image_path(out, "depth", k),
                          storage.encode_depth(frame.depth_m, scale))
        on_frame()
