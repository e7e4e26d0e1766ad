"""How time becomes way: slower round corners, now and then standing, at a distance to others."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
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


class StopAndGo:
    """The clock of traffic that flows, comes to a stand and flows again, over and over."""

    _STEP_S = 0.1

    def __init__(self, period_s: float, begin_s: float) -> None:
        """
        Args:
            period_s: of which three tenths flow and a quarter stands.
            begin_s: where in a period, which begins with flowing, time 0 is.
        """
        t = np.linspace(0.0, 1.0, round(period_s / self._STEP_S) + 1)
        brake, start = np.clip((t - 0.30) / 0.20, 0.0, 1.0), np.clip((t - 0.75) / 0.25, 0.0, 1.0)
        flow = 1.0 - brake**2 * (3.0 - 2.0 * brake) + start**2 * (3.0 - 2.0 * start)
        middle = 0.5 * (flow[1:] + flow[:-1]) * period_s * t[1]
        self._clock = np.concatenate([[0.0], np.cumsum(middle)])
        self._way = PchipInterpolator(t * period_s, self._clock)   # which never runs backwards
        self._period_s, self._begin_s = period_s, begin_s
        self._zero = self._at(begin_s)

    def __call__(self, time_s: float) -> float:
        """Time (s) on that clock; 0 at time 0, never backwards."""
        return self._at(self._begin_s + time_s) - self._zero

    def _at(self, time_s: float) -> float:
        turns, rest = divmod(time_s, self._period_s)
        return float(turns * self._clock[-1] + self._way(rest))
