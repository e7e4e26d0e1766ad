"""Functions of time that scenes are moved by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from slam.geometry import se3
from slam.geometry.arrays import Array


def pose(position: ArrayLike, yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """T_world_body (4, 4) of a body with x forward, y left, z up.

    Args:
        position: (3,) m.
        yaw, pitch, roll: rad about z, then y, then x; positive pitch lowers the nose.
    """
    R = (se3.exp_so3(np.array([0.0, 0.0, yaw])) @ se3.exp_so3(np.array([0.0, pitch, 0.0]))
         @ se3.exp_so3(np.array([roll, 0.0, 0.0])))
    return se3.from_rotation_translation(R, np.asarray(position, dtype=np.float64))


def look_at(position: ArrayLike, target: ArrayLike, roll: float = 0.0) -> Array:
    """T_world_camera (4, 4), OpenCV axes, at `position` looking at `target`, upright.

    Args:
        position, target: (3,) m in a world with z up; not one above the other.
        roll: rad about the viewing direction.
    """
    position = np.asarray(position, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward], axis=-1)
    turned = R @ se3.exp_so3(np.array([0.0, 0.0, roll]))
    return se3.from_rotation_translation(turned, position)


def camera_from_body(T_world_body: Array) -> Array:
    """T_world_camera of a camera that looks along its carrier's x axis (z up, y left)."""
    R_body_camera = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return T_world_body @ se3.from_rotation_translation(R_body_camera, np.zeros(3))


@dataclass(frozen=True, slots=True)
class Wander:
    """Smooth, band-limited random motion: per axis a sum of sinusoids of random phase."""

    amplitude: Array     # (A, F)
    frequency_hz: Array  # (A, F)
    phase: Array         # (A, F) rad

    @classmethod
    def draw(cls, rng: np.random.Generator, rms: ArrayLike, band_hz: tuple[float, float],
             sines: int = 5) -> Wander:
        """Random motion with the given RMS per axis and energy spread evenly over the band.

        Args:
            rms: (A,) in the unit of the result.
            band_hz: lowest and highest frequency.
        """
        rms = np.asarray(rms, dtype=np.float64)
        edges = np.linspace(*band_hz, sines + 1)
        frequency = rng.uniform(edges[:-1], edges[1:], size=(len(rms), sines))
        # Lower frequencies carry more, as in a hand: constant speed over the band.
        weight = 1.0 / frequency
        weight *= np.sqrt(2.0) * rms[:, None] / np.linalg.norm(weight, axis=1, keepdims=True)
        return cls(weight, frequency, rng.uniform(0.0, 2.0 * np.pi, size=frequency.shape))

    def __call__(self, time_s: float) -> Array:
        """(A,) at that time."""
        angle = 2.0 * np.pi * self.frequency_hz * time_s + self.phase
        return np.asarray(np.sum(self.amplitude * np.sin(angle), axis=-1))


class ClosedPath:
    """A smooth closed curve in the plane, by its arc length."""

    _STEP_M = 0.25

    def __init__(self, corners: ArrayLike, radius_m: float, blend_m: float = 1.5) -> None:
        """A polygon with rounded corners, its curvature blended so that turning sets in gently.

        Args:
            corners: (N, 2) m, convex, in driving order.
            radius_m: of the rounding.
            blend_m: standard deviation of the blending along the curve.
        """
        raw = _rounded(np.asarray(corners, dtype=np.float64), radius_m, self._STEP_M)
        smooth = gaussian_filter1d(raw, blend_m / self._STEP_M, axis=0, mode="wrap")
        closed = np.vstack([smooth, smooth[:1]])
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        self.length_m = float(s[-1])
        self._xy = CubicSpline(s, closed, bc_type="periodic")
        self._tangent = self._xy.derivative()

    def __call__(self, s_m: float) -> tuple[Array, float]:
        """Position (2,) and heading (rad) at arc length s, which may exceed the length."""
        s = s_m % self.length_m
        dx, dy = self._tangent(s)
        return np.asarray(self._xy(s)), float(np.arctan2(dy, dx))

    def nearest(self, point: ArrayLike) -> float:
        """Arc length (m) of the point of the curve nearest to `point` (2,)."""
        s = np.arange(0.0, self.length_m, self._STEP_M)
        return float(s[np.argmin(np.linalg.norm(self._xy(s) - np.asarray(point), axis=1))])


def _rounded(corners: Array, radius: float, step: float) -> Array:
    """Points about every `step` along a convex polygon whose corners are arcs."""
    pieces = []
    for k in range(len(corners)):
        before, here, after = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
        into = (here - before) / np.linalg.norm(here - before)
        out = (after - here) / np.linalg.norm(after - here)
        turn = np.arctan2(into[0] * out[1] - into[1] * out[0], into @ out)
        cut = radius * np.tan(abs(turn) / 2.0)
        start, end = here - cut * into, here + cut * out
        side = np.sign(turn) * np.array([-into[1], into[0]])
        count = max(2, round(radius * abs(turn) / step))
        angle = np.linspace(0.0, abs(turn), count, endpoint=False)[:, None]
        arc = start + radius * (np.sin(angle) * into + (1.0 - np.cos(angle)) * side)
        next_in = (corners[(k + 2) % len(corners)] - after)
        next_in = next_in / np.linalg.norm(next_in)
        next_turn = np.arctan2(out[0] * next_in[1] - out[1] * next_in[0], out @ next_in)
        straight_end = after - radius * np.tan(abs(next_turn) / 2.0) * out
        count = max(2, round(float(np.linalg.norm(straight_end - end)) / step))
        share = np.linspace(0.0, 1.0, count, endpoint=False)[:, None]
        pieces += [arc, end + share * (straight_end - end)]
    return np.vstack(pieces)
