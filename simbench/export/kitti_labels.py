"""Rows of the KITTI tracking benchmark's labels, from exact truth."""

from __future__ import annotations

import numpy as np

from simbench.sequence import SequenceTruth
from simbench.types import FrameTruth, ObjectInfo, SceneLayout
from slam.geometry import se3
from slam.geometry.arrays import Array

_TYPES = {"car": "Car", "truck": "Truck", "bus": "Truck", "person": "Pedestrian",
          "bicycle": "Cyclist", "train": "Tram"}      # COCO's names to KITTI's; others are Misc
_UNKNOWN_OCCLUSION = 3
_CORNERS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3)


def label_rows(truth: SequenceTruth, k: int) -> list[str]:
    """A row for each object that a pixel of frame k shows, by track number.

    `frame track type truncated occluded alpha left top right bottom h w l x y z ry`: the 2D box
    is that of the visible pixels; truncated is 1 where the 3D box reaches beyond the image;
    occlusion is given as unknown (3). The 3D box is upright in the camera's frame (its vertical
    is the camera's y, the only one the layout has), turned by the heading of the object's own x
    axis, and the smallest that holds the object's parts; x y z is the middle of its bottom, m.
    """
    layout = truth.layout
    assert layout is not None
    frame, boxes = truth.frame(k), truth.part_boxes()
    seen = np.bincount(frame.instance_id.ravel(), minlength=1) > 0
    return [_row(frame, layout, each, boxes) for each in layout.objects
            if each.instance_id < len(seen) and seen[each.instance_id]]


def _row(frame: FrameTruth, layout: SceneLayout, thing: ObjectInfo, boxes: Array) -> str:
    v, u = np.nonzero(frame.instance_id == thing.instance_id)
    ry, size, bottom = upright_box(_corners_camera(frame, layout, thing, boxes),
                                   _heading(frame, thing))
    corners = box_corners(ry, size, bottom)
    alpha = _wrapped(ry - np.arctan2(bottom[0], bottom[2]))
    numbers = (alpha, u.min(), v.min(), u.max(), v.max(), *size, *bottom, ry)
    kind = _TYPES.get(thing.category, "Misc")
    return (f"{frame.index} {thing.instance_id} {kind} {int(_leaves(corners, layout))} "
            f"{_UNKNOWN_OCCLUSION} " + " ".join(f"{x:.6f}" for x in numbers) + "\n")


def _corners_camera(frame: FrameTruth, layout: SceneLayout, thing: ObjectInfo, boxes: Array
                    ) -> Array:
    """(N, 3) corners of the boxes of the object's parts, in the camera's frame."""
    parts = np.flatnonzero((layout.instance_of_part == thing.instance_id)
                           & np.isfinite(boxes[:, 0, 0]))
    lowest, highest = boxes[parts, None, 0], boxes[parts, None, 1]
    T_camera_part = se3.inverse(frame.T_world_camera) @ frame.T_world_part[parts]
    return se3.transform_points(T_camera_part, lowest + (highest - lowest) * _CORNERS
                                ).reshape(-1, 3)


def _heading(frame: FrameTruth, thing: ObjectInfo) -> float:
    """ry (rad): how far the object's x axis is turned about the camera's y axis from its x axis."""
    x, _, z = (se3.inverse(frame.T_world_camera) @ frame.T_world_part[thing.root_part])[:3, 0]
    return float(np.arctan2(-z, x))


def upright_box(points_camera: Array, ry: float) -> tuple[float, Array, Array]:
    """The smallest upright box of that heading around points (N, 3).

    Returns:
        ry (rad), (height, width, length) and the middle of its bottom in the camera's frame, m.
    """
    R = se3.exp_so3(np.array([0.0, ry, 0.0]))
    own = points_camera @ R            # along the box's length, vertical and width
    lowest, highest = own.min(axis=0), own.max(axis=0)
    length, height, width = highest - lowest
    middle = 0.5 * (lowest + highest)
    return ry, np.array([height, width, length]), R @ np.array([middle[0], highest[1], middle[2]])


def box_corners(ry: float, size: Array, bottom: Array) -> Array:
    """(8, 3) corners in the camera's frame of a box (height, width, length) on its bottom."""
    height, width, length = size
    own = (_CORNERS - [0.5, 1.0, 0.5]) * [length, height, width]
    return np.asarray(own @ se3.exp_so3(np.array([0.0, ry, 0.0])).T + bottom)


def _leaves(corners: Array, layout: SceneLayout) -> bool:
    """Whether a corner lies beside the image, or beside the camera."""
    if np.any(corners[:, 2] <= 0.0):
        return True
    camera = layout.intrinsics
    u = camera.fx * corners[:, 0] / corners[:, 2] + camera.cx
    v = camera.fy * corners[:, 1] / corners[:, 2] + camera.cy
    inside = (u >= -0.5) & (u < camera.width - 0.5) & (v >= -0.5) & (v < camera.height - 0.5)
    return not bool(np.all(inside))


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
