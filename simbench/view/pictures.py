"""Pictures of what a frame holds: colour, depth, masks, flow."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from simbench.sequence import Sequence
from slam.geometry.arrays import Array
from slam.types import Frame

TILE_WIDTH_PX = 320
_GREYED = 0.45           # how much of the image shows through a mask


@dataclass(frozen=True, slots=True)
class Scale:
    """At what depth and flow the colours end."""

    far_m: float
    longest_px: float

    @classmethod
    def of(cls, sequence: Sequence, frame: Frame) -> Scale:
        """What suits one frame."""
        measured = frame.depth_m[frame.depth_m > 0]
        flow_px = flow_px_of(sequence, frame)
        return cls(float(np.quantile(measured, 0.9)) if measured.size else 0.0,
                   0.0 if flow_px is None else
                   max(float(np.quantile(np.linalg.norm(flow_px, axis=-1), 0.98)), 1e-3))


def pictures(sequence: Sequence, frame: Frame, scale: Scale | None = None) -> dict[str, Array]:
    """(H, W, 3) uint8 pictures of a frame by what they show; coloured to its own scale if None."""
    k = frame.index
    scale = scale or Scale.of(sequence, frame)
    out = {f"frame {k}, {frame.stamp_s - sequence.stamps_s[0]:.2f} s": frame.rgb}
    if scale.far_m > 0:
        out[f"depth, 0 to {scale.far_m:.1f} m"] = depth_picture(frame.depth_m, scale.far_m)
    if frame.right is not None:
        out["right"] = frame.right
    labels = labels_of(sequence, frame)
    if labels is not None:
        out["masks"] = mask_picture(frame.rgb, labels)
    flow_px = flow_px_of(sequence, frame)
    if flow_px is not None:
        out[f"flow to here, {scale.longest_px:.1f} px"] = flow_picture(flow_px, scale.longest_px)
    return out


def depth_picture(depth_m: Array, far_m: float) -> Array:
    """(H, W, 3) uint8, near is red, far is blue; black where nothing was measured."""
    near_first = np.clip(255.0 * (1.0 - depth_m / far_m), 0, 255).astype(np.uint8)
    colour = cv2.applyColorMap(near_first, cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where((depth_m > 0)[..., None], colour, np.uint8(0))


def mask_picture(rgb: Array, labels: Array) -> Array:
    """(H, W, 3) uint8: the image in grey, each label in a colour of its own."""
    grey = cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY)[..., None]
    hue = (labels * 67 % 180).astype(np.uint8)   # steps of 134°: neighbours differ widely
    full = np.full_like(hue, 255)
    colour = cv2.cvtColor(np.stack([hue, full, full], axis=-1), cv2.COLOR_HSV2RGB)
    mixed = (_GREYED * grey + (1.0 - _GREYED) * colour).astype(np.uint8)
    return np.where((labels > 0)[..., None], mixed, np.repeat(grey, 3, axis=-1))


def flow_picture(flow_px: Array, longest_px: float) -> Array:
    """(H, W, 3) uint8: direction as hue, length as saturation."""
    hue = (np.degrees(np.arctan2(flow_px[..., 1], flow_px[..., 0])) % 360.0 / 2.0).astype(np.uint8)
    length = np.linalg.norm(flow_px, axis=-1)
    saturation = np.clip(255.0 * length / longest_px, 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(np.stack([hue, saturation, np.full_like(hue, 255)], axis=-1),
                                   cv2.COLOR_HSV2RGB))


def labels_of(sequence: Sequence, frame: Frame) -> Array | None:
    """(H, W) mask labels of a frame: the recording's own, else the true ones, else None."""
    if frame.instance_id is None and sequence.truth is not None:
        return sequence.truth.true_instances(frame.index)
    return frame.instance_id


def flow_px_of(sequence: Sequence, frame: Frame) -> Array | None:
    """(H, W, 2) flow to a frame: the recording's own, else the true one, else None."""
    if frame.flow is not None:
        return frame.flow.flow_px
    if frame.index > 0 and sequence.truth is not None and sequence.truth.has_images:
        return sequence.truth.flow(frame.index - 1, frame.index).flow_px
    return None


def tile(title: str, picture: Array) -> Array:
    """(h, 320, 3) uint8: the picture shrunk, its title above it."""
    height = round(picture.shape[0] * TILE_WIDTH_PX / picture.shape[1])
    small = cv2.resize(np.ascontiguousarray(picture), (TILE_WIDTH_PX, height),
                       interpolation=cv2.INTER_AREA)
    strip = np.full((18, TILE_WIDTH_PX, 3), 255, np.uint8)
    cv2.putText(strip, title, (3, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([strip, small])
