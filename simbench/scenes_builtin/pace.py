"""How fast somebody goes round a closed path: slower where it turns."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from simbench.motion import ClosedPath

_SOFT_S = 0.2


class Pace:
    """Arc length along a closed path by the time on the own clock of who goes there."""

    _STEP_M = 0.25

    def __init__(self, path: ClosedPath, cruise_m_s: float, sideways_m_s2: float,
                 round_s: float | None = None) -> None:
        """
        Args:
            cruise_m_s: where the path is straight.
            sideways_m_s2: acceleration to which turns are slowed down.
            round_s: makes all of it faster or slower, so that one round takes so long.
        """
        count = round(path.length_m / self._STEP_M)
        s = np.linspace(0.0, path.length_m, count + 1)
        heading = np.unwrap([path(float(each))[1] for each in s[:-1]])
        curvature = np.abs(np.gradient(heading, s[1]))
        speed = np.minimum(cruise_m_s, np.sqrt(sideways_m_s2 / np.maximum(curvature, 1e-6)))
        # Braking sets in about as long before a turn as one drives in half a second.
        speed = gaussian_filter1d(speed, 0.5 * cruise_m_s / s[1], mode="wrap")
        clock = np.concatenate([[0.0], np.cumsum(s[1] / speed)])
        if round_s is not None:
            clock *= round_s / clock[-1]
        self.round_s, self._length_m = float(clock[-1]), path.length_m
        self._clock, self._s = clock, s
        self._way = CubicSpline(clock, s)

    def __call__(self, clock_s: float) -> float:
        """Arc length (m) at that time; it grows on beyond one round."""
        turns, rest = divmod(clock_s, self.round_s)
        return float(turns * self._length_m + self._way(rest))

    def clock_at(self, s_m: float) -> float:
        """The time (s), within the first round, at which that arc length is reached."""
        return float(np.interp(s_m, self._s, self._clock))


def kept_between(gap_s: float, low_s: float, high_s: float) -> float:
    """A time ahead of somebody that goes smoothly over into its limits."""
    gap = low_s + _SOFT_S * np.logaddexp(0.0, (gap_s - low_s) / _SOFT_S)
    return float(high_s - _SOFT_S * np.logaddexp(0.0, (high_s - gap) / _SOFT_S))
