"""Frames with what a system saw in them: points, lines, masks and speeds (SDPL-SLAM Fig. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from slam.geometry.arrays import Array
from slam.types import Frame, FrameEstimate, ObjectEstimate, Status

STATIC_POINT = (230, 40, 40)     # red, as in the paper; RGB
OBJECT_POINT = (255, 176, 0)     # amber
STATIC_LINE = (60, 110, 255)     # blue
DYNAMIC_LINE = (40, 200, 70)     # green
LOST = (255, 80, 80)
TINTS = ((0, 158, 115), (230, 159, 0), (204, 121, 167), (86, 180, 233), (240, 228, 66),
         (213, 94, 0), (0, 114, 178))   # Okabe and Ito: told apart by the colour-blind, too
STILL_TINT = (190, 190, 190)
_TINT_SHARE = 0.22
_FINE = 4                        # drawing in quarters of a pixel: 2 fractional bits
_SHIFT = 2


@dataclass(frozen=True, slots=True)
class Picture:
    """One drawn frame."""

    index: int
    stamp_s: float
    jpeg: bytes
    width: int
    height: int
    caption: str


class Filmstrip:
    """An observer of a run that draws some of its frames, evenly spread and never the first.

    Args:
        frames: how many the run has.
        count: how many to draw.
    """

    def __init__(self, frames: int, count: int = 6) -> None:
        spread = np.linspace(0, frames - 1, min(count, max(1, frames - 1)) + 1)[1:]
        self._wanted = {round(float(k)) for k in spread} if frames > 1 else {0}
        self._last_stamp_s: float | None = None
        self.pictures: list[Picture] = []

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        if frame.index in self._wanted:
            self.pictures.append(picture(frame, estimate, self._last_stamp_s))
        self._last_stamp_s = frame.stamp_s


def picture(frame: Frame, estimate: FrameEstimate, last_stamp_s: float | None) -> Picture:
    """Draw a frame, at twice its size where it is small, as a JPEG."""
    moving = {motion.instance_id: (track, motion) for track, motion in estimate.objects.items()}
    scale = 2 if frame.rgb.shape[1] <= 800 else 1
    image = _enlarged(frame.rgb, scale)
    if frame.instance_id is not None:
        image = _tint_masks(image, frame.instance_id, moving, scale)
    _draw_segments(image, estimate, scale)
    _draw_points(image, estimate, scale)
    speeds = {} if last_stamp_s is None or frame.stamp_s <= last_stamp_s else shown_speeds({
        track: speed_m_s(motion, frame.stamp_s - last_stamp_s)
        for track, motion in moving.values()})
    if frame.instance_id is not None:
        _write_speeds(image, frame.instance_id, moving, speeds, scale)
    if estimate.status is Status.LOST:
        _write_tag(image, "LOST", (50.0, 44.0), LOST)
    ok, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]),
                            [cv2.IMWRITE_JPEG_QUALITY, 82])
    assert ok   # OpenCV can always encode an 8-bit image in memory
    return Picture(frame.index, frame.stamp_s, jpeg.tobytes(), image.shape[1], image.shape[0],
                   _caption(frame, estimate, speeds))


def speed_m_s(motion: ObjectEstimate, seconds: float) -> float:
    """How fast the object's points move: ‖H c − c‖ / Δt with c their centroid."""
    moved = motion.H_world[:3, :3] @ motion.centroid_world + motion.H_world[:3, 3]
    return float(np.linalg.norm(moved - motion.centroid_world) / seconds)


def shown_speeds(speeds_m_s: Mapping[int, float]) -> dict[int, str]:
    """All in km/h where anything drives, else in m/s, for what swings or walks."""
    if max(speeds_m_s.values(), default=0.0) > 3.0:
        return {track: f"{3.6 * speed:.0f} km/h" for track, speed in speeds_m_s.items()}
    return {track: f"{speed:.2f} m/s" for track, speed in speeds_m_s.items()}


def tint_of(track: int) -> tuple[int, int, int]:
    """The colour of a track."""
    return TINTS[track % len(TINTS)]


def _enlarged(rgb: Array, scale: int) -> Array:
    if scale == 1:
        return rgb.copy()
    size = (rgb.shape[1] * scale, rgb.shape[0] * scale)
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_LINEAR))


def _tint_masks(image: Array, labels: Array, moving: Mapping[int, tuple[int, ObjectEstimate]],
                scale: int) -> Array:
    """Fill each mask lightly and draw its outline; grey where nothing moves."""
    size = (image.shape[1], image.shape[0])
    for label in np.unique(labels[labels != 0]):
        mask = cv2.resize((labels == label).astype(np.uint8), size,
                          interpolation=cv2.INTER_NEAREST)
        known = moving.get(int(label))
        colour = STILL_TINT if known is None else tint_of(known[0])
        if known is not None:
            filled = (1 - _TINT_SHARE) * image[mask > 0] + _TINT_SHARE * np.array(colour)
            image[mask > 0] = filled.astype(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, colour, scale, cv2.LINE_AA)
    return image


def _is_static(labels: Array, estimate: FrameEstimate) -> Array:
    return np.asarray((labels == 0) | np.isin(labels, list(estimate.static_labels)))


def _fixed(uv_px: Array, scale: int) -> Array:
    """Pixel centres at integers, enlarged about the image's corner, in fixed point."""
    return np.round(((uv_px + 0.5) * scale - 0.5) * _FINE).astype(np.int32)


def _draw_points(image: Array, estimate: FrameEstimate, scale: int) -> None:
    points = estimate.points
    if points is None or not len(points):
        return
    static = _is_static(points.instance_id, estimate)
    radius = round(_FINE * (1.2 if scale == 1 else 2.0))
    for chosen, colour in ((static, STATIC_POINT), (~static, OBJECT_POINT)):
        for centre in _fixed(points.uv_px[chosen], scale):
            cv2.circle(image, tuple(centre.tolist()), radius, colour, -1, cv2.LINE_AA, _SHIFT)


def _draw_segments(image: Array, estimate: FrameEstimate, scale: int) -> None:
    segments = estimate.segments
    if segments is None or not len(segments):
        return
    static = _is_static(segments.instance_id, estimate)
    for chosen, colour in ((static, STATIC_LINE), (~static, DYNAMIC_LINE)):
        ends = _fixed(segments.endpoints_px[chosen], scale)
        cv2.polylines(image, list(ends), False, colour, scale, cv2.LINE_AA, _SHIFT)


def _write_speeds(image: Array, labels: Array,
                  moving: Mapping[int, tuple[int, ObjectEstimate]],
                  speeds: Mapping[int, str], scale: int) -> None:
    for label, (track, _) in moving.items():
        top = _top_of(labels == label)
        if track in speeds and top is not None:
            at = (top[0] * scale, top[1] * scale)
            _write_tag(image, speeds[track], at, tint_of(track), 0.75 if scale > 1 else 0.55)


def _top_of(mask: Array) -> tuple[float, float] | None:
    """Middle (u, v) of the first row in which a mask is wide: below the rod of a pendulum."""
    widths = np.count_nonzero(mask, axis=1)
    if not widths.any():
        return None
    v = int(np.argmax(widths >= 0.3 * widths.max()))
    return float(np.median(np.flatnonzero(mask[v]))), float(v)


def _write_tag(image: Array, text: str, above: tuple[float, float],
               colour: tuple[int, int, int], size: float = 0.75) -> None:
    """Dark text on a tag of the colour, its foot on a point, kept inside the image."""
    pad = round(8 * size)
    (width, height), foot = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 2)
    left = int(np.clip(above[0] - width / 2 - pad, 0, max(0, image.shape[1] - width - 2 * pad)))
    tall = height + foot + 2 * pad
    bottom = int(np.clip(above[1] - 4, tall, image.shape[0] - 1))
    cv2.rectangle(image, (left, bottom - tall), (left + width + 2 * pad, bottom), colour, -1)
    cv2.putText(image, text, (left + pad, bottom - pad - foot + 2), cv2.FONT_HERSHEY_SIMPLEX,
                size, (16, 18, 20), 2, cv2.LINE_AA)


def _caption(frame: Frame, estimate: FrameEstimate, speeds: Mapping[int, str]) -> str:
    parts = [f"frame {frame.index}, {frame.stamp_s:.2f} s"]
    if estimate.points is not None:
        parts.append(f"{len(estimate.points)} points")
    if estimate.segments is not None:
        parts.append(f"{len(estimate.segments)} lines")
    parts += [f"track {track}: {speed}" for track, speed in sorted(speeds.items())]
    if estimate.status is Status.LOST:
        parts.append(f"lost: {estimate.reason}")
    return " · ".join(parts)
