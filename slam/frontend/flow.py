"""Dense optical flow: estimated (DIS), predicted from depth and motions, checked and sampled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, Protocol

import cv2
import numba
import numpy as np

from slam.frontend.sampling import bilinear
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, Intrinsics


def given_flow(before: Frame, frame: Frame) -> FlowField | None:
    """The flow that a frame brings, if it is from the frame before and not from one between."""
    return frame.flow if frame.index == before.index + 1 else None


class FlowEstimator(Protocol):
    """Dense flow from one image to the next; equal inputs give equal outputs."""

    def __call__(self, previous_gray: Array, current_gray: Array,
                 predicted_px: Array | None = None) -> FlowField:
        """Flow on the previous image's pixels.

        Args:
            previous_gray, current_gray: (H, W) uint8.
            predicted_px: (H, W, 2) float32 flow to start from, where something is known.
        """
        ...


class DisFlow:
    """Dense inverse search (Kroeger et al. 2016) by OpenCV.

    Pictures that are too small for the preset's coarsest scale are continued by their last rows
    and columns: OpenCV would choose other scales for them, for good, or raise, or crash.
    """

    def __init__(self, preset: Literal["ultrafast", "fast", "medium"] = "medium") -> None:
        presets = {"ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
                   "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
                   "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM}
        if preset not in presets:
            raise ValueError(f"no DIS preset {preset!r}; there are {', '.join(presets)}")
        self._dis = cv2.DISOpticalFlow_create(presets[preset])
        patch, scale = self._dis.getPatchSize(), 2.0 ** self._dis.getFinestScale()
        self._short_px = math.ceil(patch * scale)
        self._long_px = math.ceil(4 * patch * scale / math.sqrt(2))   # OpenCV rounds its log

    def __call__(self, previous_gray: Array, current_gray: Array,
                 predicted_px: Array | None = None) -> FlowField:
        """Flow on the previous image's pixels; with a prediction only the rest is estimated."""
        if predicted_px is None:
            return FlowField(self._estimate(previous_gray, current_gray))
        back_warped, landed = warp_back(current_gray, predicted_px)
        rest = self._estimate(previous_gray, back_warped)
        # Where the prediction leaves the image nothing was there to be estimated.
        rest[~landed] = 0.0
        return FlowField(predicted_px + rest)

    def _estimate(self, previous: Array, current: Array) -> Array:
        height, width = previous.shape
        missing = [max(0, least - side)
                   for side, least in zip((height, width), self._least(height, width), strict=True)]
        if not any(missing):
            return np.asarray(self._dis.calc(previous, current, None))
        padded = (cv2.copyMakeBorder(image, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
                  for image in (previous, current))
        return np.ascontiguousarray(self._dis.calc(*padded, None)[:height, :width])

    def _least(self, height: int, width: int) -> tuple[int, int]:
        """The smallest height and width that the preset's scales can be made of."""
        return ((self._long_px, self._short_px) if height > width
                else (self._short_px, self._long_px))


def warp_back(current: Array, flow_px: Array) -> tuple[Array, Array]:
    """The current image as the previous one would see it, and (H, W) bool: inside the image."""
    u, v = _grid(flow_px.shape)
    u, v = flow_px[..., 0] + u, flow_px[..., 1] + v
    warped = cv2.remap(current, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    height, width = current.shape[:2]
    return np.asarray(warped), (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)


def predicted_flow(depth_m: Array, label_index: Array, T_current_previous: Array,
                   motions: Mapping[int, Array], intrinsics: Intrinsics) -> Array:
    """Flow that depth and rigid motions would give.

    A pixel without depth moves as if it were infinitely far.

    Args:
        depth_m: (H, W) float32 z-depth of the previous frame, 0 where there is none.
        label_index: (H, W) uint8 which thing each pixel of the previous frame shows.
        T_current_previous: (4, 4), previous camera to current camera, for all that stands still.
        motions: index -> (4, 4) that maps the thing's points in the previous camera's frame to
            the current camera's frame.
    Returns:
        (H, W, 2) float32 on the previous frame's pixels.
    """
    T = np.stack([T_current_previous, *motions.values()])
    K = intrinsics.matrix
    # As differences from the identity, so that float32 loses nothing to the coordinates' size.
    H = (K @ T[:, :3, :3] @ np.linalg.inv(K) - np.eye(3)).astype(np.float32)
    t = (K @ T[:, :3, 3:])[:, :, 0].astype(np.float32)
    motion_of = np.zeros(256, np.int64)
    motion_of[list(motions)] = np.arange(1, len(T))
    return np.asarray(_rigid_flow(depth_m, label_index, motion_of, H, t))


@numba.njit(cache=True, nogil=True)
def _rigid_flow(depth_m, label_index, motion_of, H, t):  # type: ignore[no-untyped-def]
    """Flow of p ~ (I + H) (u, v, 1) + t/z: its difference from (u, v) over its third row."""
    height, width = depth_m.shape
    flow = np.empty((height, width, 2), np.float32)
    one = np.float32(1.0)
    for row in range(height):
        v = np.float32(row)
        for column in range(width):
            u, z = np.float32(column), depth_m[row, column]
            inverse = one / z if z > 0.0 else np.float32(0.0)
            m = motion_of[label_index[row, column]]
            du = H[m, 0, 0] * u + H[m, 0, 1] * v + H[m, 0, 2] + t[m, 0] * inverse
            dv = H[m, 1, 0] * u + H[m, 1, 1] * v + H[m, 1, 2] + t[m, 1] * inverse
            dw = H[m, 2, 0] * u + H[m, 2, 1] * v + H[m, 2, 2] + t[m, 2] * inverse
            scale = one / max(one + dw, np.float32(1e-3))
            flow[row, column, 0] = (du - u * dw) * scale
            flow[row, column, 1] = (dv - v * dw) * scale
    return flow


def sample_flow(flow: FlowField, uv_px: Array,
                instance_id: Array | None = None) -> tuple[Array, Array]:
    """Flow (N, 2) and whether it is known (N,) at positions (N, 2) of the previous image.

    Bilinear, except that the nearest pixel counts alone where one of the 2×2 neighbours is
    invalid or lies on another instance.
    """
    none = np.zeros((0, 0), np.bool_)
    return _sample(flow.flow_px, none if flow.valid is None else flow.valid,
                   none if instance_id is None else instance_id, np.asarray(uv_px, np.float64))


@numba.njit(cache=True, nogil=True)
def _sample(flow, valid, label, uv):  # type: ignore[no-untyped-def]
    height, width = flow.shape[:2]
    out, known = np.zeros((len(uv), 2)), np.zeros(len(uv), np.bool_)
    for n in range(len(uv)):
        u, v = uv[n]
        if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
            continue
        left, top = min(int(u), max(width - 2, 0)), min(int(v), max(height - 2, 0))
        a, b = u - left, v - top
        near = (top + int(b > 0.5), left + int(a > 0.5))
        if not _is_known(flow, valid, near[0], near[1]):
            continue
        known[n] = True
        du = dv = 0.0
        whole = True
        for i in range(top, min(top + 2, height)):
            for j in range(left, min(left + 2, width)):
                whole &= _is_known(flow, valid, i, j) and (
                    label.size == 0 or label[i, j] == label[top, left])
                weight = (b if i > top else 1.0 - b) * (a if j > left else 1.0 - a)
                du += weight * flow[i, j, 0]
                dv += weight * flow[i, j, 1]
        if whole:
            out[n, 0], out[n, 1] = du, dv
        else:
            out[n, 0], out[n, 1] = flow[near[0], near[1], 0], flow[near[0], near[1], 1]
    return out, known


@numba.njit(cache=True, nogil=True)
def _is_known(flow, valid, i, j):  # type: ignore[no-untyped-def]
    return (np.isfinite(flow[i, j, 0]) and np.isfinite(flow[i, j, 1])
            and (valid.size == 0 or valid[i, j]))


def local_warps(flow_px: Array, uv_px: Array, reach_px: int = 4) -> Array:
    """(N, 2, 2) warps of small offsets around positions (N, 2): the identity plus the flow's slope.

    The slope is taken `reach_px` to each side, so the flow has to be smooth there: one predicted
    from depth, at points off the borders of objects.
    """
    step = float(reach_px) * np.eye(2)
    slope = np.stack([bilinear(flow_px, uv_px + step[k]) - bilinear(flow_px, uv_px - step[k])
                      for k in range(2)], axis=-1) / (2.0 * reach_px)
    return np.asarray(np.eye(2) + slope)


def round_trip_error(forward: FlowField, backward: FlowField, uv_px: Array) -> Array:
    """Forward–backward distance (N,) in px at positions (N, 2); inf where a flow is unknown."""
    there, known = sample_flow(forward, uv_px)
    back, known_back = sample_flow(backward, uv_px + there)
    return np.where(known & known_back, np.linalg.norm(there + back, axis=-1), np.inf)


def _grid(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Columns (1, W) and rows (H, 1), float32, that broadcast to an image."""
    return (np.arange(shape[1], dtype=np.float32)[None],
            np.arange(shape[0], dtype=np.float32)[:, None])
