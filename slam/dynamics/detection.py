"""Detections of things in an image: a protocol, and a COCO network of the user's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from slam.geometry.arrays import Array
from slam.types import Boxes2D

# The 80 classes of COCO 2017 in the order of its detectors; `Boxes2D.label` counts from 0.
COCO_CLASSES: tuple[str, ...] = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat",
    "traffic light", "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog",
    "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella",
    "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball", "kite",
    "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange",
    "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant",
    "bed", "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone",
    "microwave", "oven", "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors",
    "teddy bear", "hair drier", "toothbrush",
)
UNKNOWN_CLASS = -1
_GREY = 114   # what YOLO pads with


class Detector(Protocol):
    """Finds things in an image; equal images give equal boxes."""

    def __call__(self, rgb: Array) -> Boxes2D:
        """Boxes in (H, W, 3) uint8, within the image."""
        ...


class BadDetector(ValueError):
    """A weights file that is missing, cannot be read, or gives another output than boxes."""


@dataclass(frozen=True, slots=True)
class DetectorConfig:
    """What is kept of a network's answers."""

    input_px: int = 640           # side of the square that the network is given
    least_score: float = 0.3
    most_overlap: float = 0.45    # of two boxes of one class that both stay: IoU
    most_boxes: int = 100         # the best scored


class OnnxDetector:
    """A COCO detector in an ONNX file, run by OpenCV: YOLOv5, v8, v11 or v10 as exported."""

    def __init__(self, weights: Path, config: DetectorConfig | None = None) -> None:
        """Load the network and try it on a grey image.

        Raises:
            BadDetector: no such file, no network in it, or an output of another shape.
        """
        self.config = DetectorConfig() if config is None else config
        self._weights = weights
        if not weights.is_file():
            raise BadDetector(f"{weights}: no such file; give the ONNX weights of a COCO detector")
        try:
            self._net: Any = cv2.dnn.readNetFromONNX(str(weights))
        except cv2.error as error:
            raise BadDetector(f"{weights}: OpenCV cannot load it as ONNX ({_reason(error)}); "
                              "export it again, with a fixed input size and opset 12 to 17"
                              ) from None
        self(np.full((self.config.input_px, self.config.input_px, 3), _GREY, np.uint8))

    def __call__(self, rgb: Array) -> Boxes2D:
        """Boxes within the image, non-maxima of each class suppressed, best first."""
        height, width = rgb.shape[:2]
        square, scale = _letterbox(rgb, self.config.input_px)
        blob = np.ascontiguousarray(square.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
        try:
            self._net.setInput(blob)
            output = np.asarray(self._net.forward())
        except cv2.error as error:
            raise BadDetector(f"{self._weights}: the network does not take a "
                              f"{self.config.input_px} px image ({_reason(error)}); export it "
                              "for that size") from None
        corners, score, label = _decoded(output, self._weights)
        corners = np.clip(corners / scale, 0.0, [width - 1, height - 1, width - 1, height - 1])
        return best_boxes(corners, score, label, self.config)


def best_boxes(corners_px: Array, score: Array, label: Array, config: DetectorConfig) -> Boxes2D:
    """The boxes (N, 4) that score well and do not repeat a better one of their class."""
    size = corners_px[:, 2:] - corners_px[:, :2]
    usable = np.flatnonzero(np.all(np.isfinite(corners_px), axis=1) & np.all(size > 0, axis=1)
                            & (score >= config.least_score))
    if not len(usable):
        return Boxes2D(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))
    corners_px, score, label = corners_px[usable], score[usable], label[usable]
    whs = np.hstack([corners_px[:, :2], corners_px[:, 2:] - corners_px[:, :2]])
    kept = cv2.dnn.NMSBoxesBatched(whs.tolist(), score.astype(np.float32).tolist(),
                                   label.astype(np.int32).tolist(), config.least_score,
                                   config.most_overlap)
    best = np.asarray(kept, np.int64).ravel()
    best = best[np.argsort(-score[best], kind="stable")][:config.most_boxes]
    return Boxes2D(corners_px[best], score[best], label[best].astype(np.int64))


def _letterbox(rgb: Array, side: int) -> tuple[Array, float]:
    """(side, side, 3) with the image at its top left, and how much it was scaled."""
    height, width = rgb.shape[:2]
    scale = side / max(height, width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    square = np.full((side, side, 3), _GREY, np.uint8)
    square[:size[1], :size[0]] = cv2.resize(np.ascontiguousarray(rgb), size,
                                            interpolation=cv2.INTER_LINEAR)
    return square, scale


def _decoded(output: Array, weights: Path) -> tuple[Array, Array, Array]:
    """Corners (N, 4) in pixels of the square, score (N,) and label (N,). Raises BadDetector.

    (1, 84, N): centre, size, 80 class scores (YOLOv8, v11); (1, N, 85): the same with an
    objectness before the classes (YOLOv5); (1, N, 6): corners, score, class (YOLOv10).
    """
    classes = len(COCO_CLASSES)
    rows = output[0] if output.ndim == 3 and output.shape[0] == 1 else np.zeros((0, 0))
    if rows.shape[0] == 4 + classes:
        rows = rows.T
    rows = rows.astype(np.float64)
    if rows.shape[1] == 6:
        return rows[:, :4], rows[:, 4], np.clip(rows[:, 5], 0, classes - 1).astype(np.int64)
    if rows.shape[1] not in (4 + classes, 5 + classes):
        raise BadDetector(
            f"{weights}: the network's output has the shape {output.shape}; wanted (1, 84, N), "
            "(1, N, 85) or (1, N, 6), as YOLO detectors of the 80 COCO classes give it")
    each = rows[:, -classes:] * (rows[:, 4:5] if rows.shape[1] == 5 + classes else 1.0)
    each = np.nan_to_num(each, nan=0.0)
    label = np.argmax(each, axis=1)
    half = 0.5 * rows[:, 2:4]
    corners = np.hstack([rows[:, :2] - half, rows[:, :2] + half])
    return corners, each[np.arange(len(rows)), label], label


def _reason(error: cv2.error) -> str:
    """OpenCV's own words without its file names."""
    text = str(error).split("error:")[-1].split(" in function")[0]
    return " ".join(text.split())[:120]
