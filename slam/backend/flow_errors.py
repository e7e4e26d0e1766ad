"""How the errors of flow that is given hang together from one frame to the next.

Where a pixel's flow ends, the next frame's flow begins. Noise of places in frames (as a feature's
localisation errs) is in both with opposite signs; noise that each field has of its own is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.backend.step_errors import MOST_CORRELATION
from slam.frontend.observe import Observation
from slam.frontend.sampling import inside, nearest
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.types import FlowField, Intrinsics

_EVERY_PX = 8            # between the pixels asked, along rows and columns
_FAR = 3.0               # medians: a pixel that errs by more does not show what stands still


@dataclass(frozen=True, slots=True)
class _Errors:
    landed: Array        # (N, 2) whole px in the later frame, where the motion leads
    error: Array         # (N, 2) px of the flow against the motion; NaN where it is not known


class SuccessiveErrors:
    """Measures over a run the correlation of the flow's errors with those one frame on."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self.intrinsics = intrinsics
        self._last: _Errors | None = None
        self._product = self._square = 0.0

    @property
    def correlation(self) -> float:
        """Of an error with the next one at its place; 0 as long as nothing tells."""
        if self._square == 0.0:
            return 0.0
        return float(np.clip(self._product / self._square, -MOST_CORRELATION, MOST_CORRELATION))

    def take_in(self, flow: FlowField, before: Observation, T_now_before: Array) -> None:
        """One more field of flow, from a frame to the next, with the camera's motion."""
        if self._last is not None:
            last = self._last
            own = self._errors(flow, before, T_now_before, last.landed).error
            both = np.isfinite(own).all(axis=1) & np.isfinite(last.error).all(axis=1)
            self._product += float(np.sum(own[both] * last.error[both]))
            self._square += 0.5 * float(np.sum(own[both]**2 + last.error[both]**2))
        v, u = np.mgrid[_EVERY_PX // 2:before.rho.shape[0]:_EVERY_PX,
                        _EVERY_PX // 2:before.rho.shape[1]:_EVERY_PX]
        uv = np.stack([u.reshape(-1), v.reshape(-1)], axis=-1).astype(np.float64)
        self._last = self._errors(flow, before, T_now_before, uv)

    def interrupted(self) -> None:
        """The next field does not begin where the last one ended."""
        self._last = None

    def _errors(self, flow: FlowField, before: Observation, T_now_before: Array, uv: Array
                ) -> _Errors:
        """Of whole pixels (N, 2) that show what stands still."""
        rho = nearest(before.rho, uv)
        moved = (pinhole.rays(self.intrinsics, uv) @ T_now_before[:3, :3].T
                 + rho[:, None] * T_now_before[:3, 3])
        known = ((rho > 0) & (nearest(before.label_index, uv) == 0)
                 & inside(uv, before.rho.shape) & (moved[:, 2] > 1e-6))
        if flow.valid is not None:
            known &= nearest(flow.valid, uv)
        expected = pinhole.project(self.intrinsics,
                                   np.where(known[:, None], moved, [0.0, 0.0, 1.0]))
        error = uv + nearest(flow.flow_px, uv) - expected
        length = np.linalg.norm(error, axis=1)
        known &= length <= _FAR * np.median(length[known]) if known.any() else False
        error[~known] = np.nan
        return _Errors(np.rint(expected), error)
