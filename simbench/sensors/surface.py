"""What a depth image says of the surfaces in it: incidence, borders, a second view's shadow."""

from __future__ import annotations

import cv2
import numpy as np

from slam.geometry.arrays import Array
from slam.types import Intrinsics


def incidence_angle(depth_m: Array, intrinsics: Intrinsics) -> Array:
    """(H, W) float32 angle in radians between the ray and the surface normal; 0 without depth.

    Inverse depth w = 1/z is linear in the pixel on a plane, whose normal is
    (fx w_u, fy w_v, w − (u−cx) w_u − (v−cy) w_v): its product with the ray is w itself.
    Of both one-sided differences the smaller is taken, so a border does not look like a slope.
    """
    seen = depth_m > 0
    w = np.divide(1.0, depth_m, out=np.zeros(depth_m.shape, np.float32), where=seen)
    w_u, w_v = _smaller_difference(w, 1), _smaller_difference(w, 0)
    u = np.arange(w.shape[1], dtype=np.float32) - np.float32(intrinsics.cx)
    v = np.arange(w.shape[0], dtype=np.float32)[:, None] - np.float32(intrinsics.cy)
    normal_z = w - u * w_u - v * w_v
    w_u *= np.float32(intrinsics.fx)
    w_v *= np.float32(intrinsics.fy)
    normal = np.sqrt(w_u * w_u + w_v * w_v + normal_z * normal_z)
    ray = np.sqrt(1.0 + (u / np.float32(intrinsics.fx)) ** 2
                  + (v / np.float32(intrinsics.fy)) ** 2)
    cosine = np.divide(w, normal * ray, out=np.ones_like(w), where=seen)
    return np.arccos(np.minimum(cosine, 1.0))


def _smaller_difference(image: Array, axis: int) -> Array:
    """Of the differences to both neighbours along an axis the one of smaller magnitude."""
    difference = np.diff(image, axis=axis)
    first = np.take(difference, [0], axis=axis)
    last = np.take(difference, [-1], axis=axis)
    backward = np.concatenate([first, difference], axis=axis)
    forward = np.concatenate([difference, last], axis=axis)
    return np.where(np.abs(backward) < np.abs(forward), backward, forward)


def depth_borders(depth_m: Array, relative_jump: float) -> Array:
    """(H, W) bool: the 3×3 neighbourhood spans more than `relative_jump` of the depth."""
    window = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(depth_m, window), cv2.dilate(depth_m, window)
    return np.asarray(farthest - nearest > np.float32(relative_jump) * depth_m)


def second_view_shadow(depth_m: Array, focal_px: float, baseline_m: float) -> Array:
    """(H, W) bool: surfaces that a projector or camera `baseline_m` to the right cannot see.

    A pixel u lands there at u − f B / z. What stands farther right in this image but lands
    left of it hides it.
    """
    seen = depth_m > 0
    shift = np.divide(np.float32(focal_px * baseline_m), depth_m,
                      out=np.zeros(depth_m.shape, np.float32), where=seen)
    landing = np.arange(depth_m.shape[1], dtype=np.float32) - shift
    landing[~seen] = np.inf
    from_right = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth_m.shape, bool)
    # Half a pixel of tolerance: neighbours on one steep surface are not each other's shadow.
    hidden[:, :-1] = seen[:, :-1] & (from_right[:, 1:] < landing[:, :-1] - 0.5)
    return hidden
