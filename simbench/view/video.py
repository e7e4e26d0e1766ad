"""A sequence as a video."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from simbench.errors import UserError
from simbench.sequence import Sequence
from simbench.view.pictures import Scale, pictures, tile
from simbench.view.sheet import check_place
from slam.geometry.arrays import Array

_COLUMNS = 2
_CODECS = ("vp09", "mp4v")   # the first that OpenCV can write: browsers play VP9, not MPEG-4 part 2


def write_video(sequence: Sequence, path: Path,
                on_frame: Callable[[], None] = lambda: None) -> None:
    """An MP4 of colour, depth, masks and flow side by side, at the sequence's own pace.

    Raises:
        UserError: the path does not end in .mp4, its folder is missing, or OpenCV writes no MP4.
        BadFrame: a frame cannot be read.
    """
    check_place("--mp4", path, (".mp4",))
    steps_s = np.diff(sequence.stamps_s)
    fps = 1.0 / float(np.median(steps_s)) if len(steps_s) else 10.0
    example = sequence.frame(min(1, len(sequence) - 1))      # the first frame has no flow
    scale = Scale.of(sequence, example)
    panels = len(pictures(sequence, example, scale))
    with tempfile.TemporaryDirectory(prefix=".mp4.", dir=path.parent) as scratch:
        whole = Path(scratch) / path.name
        writer = None
        for k in range(len(sequence)):
            picture = _mosaic(pictures(sequence, sequence.frame(k), scale), panels)
            if writer is None:
                writer = _writer(whole, fps, picture)
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
            on_frame()
        assert writer is not None       # a sequence has at least one frame
        writer.release()
        shutil.move(whole, path)


def _mosaic(named: dict[str, Array], panels: int) -> Array:
    tiles = [tile(name, picture) for name, picture in named.items()][:panels]
    blank = np.full_like(tiles[0], 255)
    rows = -(-panels // _COLUMNS)
    tiles += [blank] * (rows * _COLUMNS - len(tiles))
    picture = np.vstack([np.hstack(tiles[i:i + _COLUMNS])
                         for i in range(0, len(tiles), _COLUMNS)])
    return picture[:picture.shape[0] // 2 * 2]      # codecs want even sides


def _writer(path: Path, fps: float, picture: Array) -> cv2.VideoWriter:
    height, width = picture.shape[:2]
    for codec in _CODECS:
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps,
                                 (width, height))
        if writer.isOpened():
            return writer
    raise UserError(f"--mp4 {path.name}: this OpenCV writes no MP4; install "
                    "opencv-contrib-python-headless from PyPI")
