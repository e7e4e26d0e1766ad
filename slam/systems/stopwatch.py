"""How long each stage of a frame took."""

from __future__ import annotations

from time import perf_counter


class Stopwatch:
    """Laps by stage name, in milliseconds; a stage named twice adds up."""

    def __init__(self) -> None:
        self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = perf_counter()
        self._laps[stage] = self._laps.get(stage, 0.0) + (now - self._last) * 1e3
        self._last = now

    def laps_ms(self) -> dict[str, float]:
        return dict(self._laps)
