"""Where a system breaks: the value of a dial at which a metric crosses a limit, by bisection."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simbench.errors import UserError
from simbench.metric_names import Metric, find_metric
from simbench.scene import Dial, find_scene
from simbench.statistics import LEVEL
from simbench.suites.spec import Point, Suite, point_text
from slam.geometry.arrays import Array

_RESAMPLES = 2000
DEFAULT_LIMIT = "camera.coverage=0.9"
DEFAULT_STEPS = 5        # halvings: 1/32 of the range is left


@dataclass(frozen=True, slots=True)
class Limit:
    """What a metric may be at worst."""

    metric: Metric
    value: float

    @classmethod
    def parse(cls, text: str) -> Limit:
        """From METRIC=VALUE. Raises UserError."""
        name, equals, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if not equals or not np.isfinite(value):
            raise UserError(f"--limit {text}: wanted METRIC=VALUE, as in {DEFAULT_LIMIT}")
        return cls(find_metric(name.strip()), value)

    def broken(self, values: Array) -> Array:
        """Which values are beyond the limit; none at all (NaN) is."""
        beyond = values > self.value if self.metric.better == "lower" else values < self.value
        return np.asarray(beyond | np.isnan(values))

    def __str__(self) -> str:
        sign = "<=" if self.metric.better == "lower" else ">="
        return f"{self.metric.name} {sign} {self.value:g} {self.metric.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Breaking:
    """Where a system breaks on the way from the dial's easy end to its hard end."""

    system: str
    at: float | None         # the dial's value; None: it holds all the way
    low: float | None        # an interval for it, where seeds agree that it breaks
    high: float | None
    holds_share: float       # of the resampled sets of seeds: it holds all the way
    visited: tuple[tuple[float, float | None], ...]   # (dial, mean of the metric)

    def statement(self, dial: str, limit: Limit, ends: tuple[float, float], seeds: int,
                  held: Point = ()) -> str:
        """One line for people; `held`: the dials held at other values than their defaults."""
        who = f"{self.system} with {point_text(held)}" if held else self.system
        way = f"from {dial} {ends[0]:g} to {ends[1]:g}"
        if self.at is None:
            return (f"{who}: {limit} holds {way}, in {100 * self.holds_share:.0f} % of the "
                    f"resampled sets of {seeds} seeds")
        if self.at == ends[0]:
            return (f"{who}: {limit} is broken at {dial} {ends[0]:g} already, where the "
                    "search begins; give a weaker --limit or another --from")
        text = f"{who}: {limit} holds until {dial} {self.at:.4g}"
        if self.low is not None and self.high is not None:
            text += f" [{self.low:.4g}, {self.high:.4g}], {100 * LEVEL:g} % by {seeds} seeds"
        if self.holds_share > 0:
            text += f"; in {100 * self.holds_share:.0f} % of their resamples it holds all the way"
        return text


def ends_of(scene: str, dial: str, start: float | None, end: float | None
            ) -> tuple[Dial, float, float]:
    """The dial, where the search begins (its default) and where it ends (the farther end).

    Raises:
        UserError: no such dial, one of names instead of numbers, or an end out of its range.
    """
    spec = find_scene(scene)
    spec.resolve_dials({dial: start if start is not None else _default(spec.dials, dial)})
    found = next(d for d in spec.dials if d.name == dial)
    if found.choices:
        raise UserError(f"--dial {dial}: has names ({found.allowed}) and nothing between them to "
                        f"search; hold it by --with {dial}={found.choices[0]}")
    first = found.default if start is None else start
    far = max((found.low, found.high), key=lambda value: abs(value - first))
    last = far if end is None else end
    spec.resolve_dials({dial: last})
    if first == last:
        raise UserError(f"--from {first:g} --to {last:g}: the same; give two ends")
    return found, first, last


def held_dials(scene: str, searched: str, given: Mapping[str, float | str]) -> Point:
    """The dials that a search holds at other values than the scene's defaults.

    Raises:
        UserError: no such dial, a value out of its range, or the dial that is searched.
    """
    if searched in given:
        raise UserError(f"--with {searched}={given[searched]}: is the dial that the search turns; "
                        "leave it out, or give --from and --to")
    spec = find_scene(scene)
    values = spec.resolve_dials(given)
    return tuple((dial.name, dial.shown(values[dial.name]) if dial.choices else values[dial.name])
                 for dial in spec.dials if dial.name in given)


def _default(dials: Sequence[Dial], name: str) -> float:
    return next((d.default for d in dials if d.name == name), 0.0)


def search(values_at: Callable[[str, float], Array], systems: Sequence[str], dial: Dial,
           ends: tuple[float, float], limit: Limit, steps: int = DEFAULT_STEPS) -> list[Breaking]:
    """Bisect for each system between the dial's two ends.

    Args:
        values_at: (system, dial value) to the metric of every seed (S,), NaN where there is none.
    """
    return [_search_one(values_at, system, dial, ends, limit, steps) for system in systems]


def _search_one(values_at: Callable[[str, float], Array], system: str, dial: Dial,
                ends: tuple[float, float], limit: Limit, steps: int) -> Breaking:
    seen = {ends[0]: values_at(system, ends[0]), ends[1]: values_at(system, ends[1])}
    easy, hard = ends
    if not _is_broken(limit, seen[easy]) and _is_broken(limit, seen[hard]):
        for _ in range(steps):
            middle = 0.5 * (easy + hard)
            middle = float(round(middle)) if dial.integer else middle
            if middle in seen:
                break
            seen[middle] = values_at(system, middle)
            easy, hard = (easy, middle) if _is_broken(limit, seen[middle]) else (middle, hard)
    order = sorted(seen, reverse=ends[0] > ends[1])
    return breaking_of(system, np.array(order), np.array([seen[x] for x in order]), limit)


def _is_broken(limit: Limit, values: Array) -> bool:
    return bool(limit.broken(np.array([_mean(values)]))[0])


def _mean(values: Array) -> float:
    """A seed without a value has no mean that would be right."""
    return float(values.mean())


def breaking_of(system: str, x: Array, values: Array, limit: Limit) -> Breaking:
    """The crossing, and where it lies when the seeds are drawn again.

    Args:
        x: (V,) the dial's values, from easy to hard.
        values: (V, S) the metric of every seed at each, NaN where there is none.
    """
    rng = np.random.default_rng(0)
    seeds = values.shape[1]
    drawn = rng.integers(0, seeds, (_RESAMPLES, seeds))
    crossings = np.array([crossing(x, mean, limit) for mean in values[:, drawn].mean(axis=-1).T])
    at = crossing(x, values.mean(axis=-1), limit)
    breaks = crossings[np.isfinite(crossings)]
    interval: tuple[float | None, float | None] = (None, None)
    if np.isfinite(at) and seeds > 1 and len(breaks):
        tail = 50.0 * (1.0 - LEVEL)
        low, high = np.percentile(breaks, [tail, 100.0 - tail])
        interval = (float(low), float(high))
    visited = tuple((float(v), float(m) if np.isfinite(m) else None)
                    for v, m in zip(x, values.mean(axis=-1), strict=True))
    return Breaking(system, float(at) if np.isfinite(at) else None, *interval,
                    float(np.mean(~np.isfinite(crossings))), visited)


def crossing(x: Array, means: Array, limit: Limit) -> float:
    """Where the line through (x, means), both (V,), first crosses the limit; NaN: nowhere.

    x goes from easy to hard. Broken at the first point already: that point. Into a point without
    a value: halfway.
    """
    broken = limit.broken(means)
    if not broken.any():
        return float("nan")
    i = int(np.argmax(broken))
    if i == 0:
        return float(x[0])
    before, after = means[i - 1], means[i]
    share = 0.5 if np.isnan(after) else (limit.value - before) / (after - before)
    return float(x[i - 1] + share * (x[i] - x[i - 1]))


def swept(suite: Suite, dial: str, values: tuple[float, ...]) -> Suite:
    """The suite with its only case at these values of the dial; what is held stays held."""
    case = suite.cases[0]
    return replace(suite, cases=(replace(case, sweep=(*case.sweep, (dial, values))),))


def as_json(found: Sequence[Breaking], dial: str, limit: Limit, ends: tuple[float, float],
            seeds: int, held: Point = ()) -> list[Mapping[str, Any]]:
    """The search's answer as breaking.json holds it."""
    return [{"system": each.system, "dial": dial, "with": dict(held), "limit": str(limit),
             "at": each.at, "low": each.low, "high": each.high, "holds_share": each.holds_share,
             "visited": [{"value": v, "mean": m} for v, m in each.visited],
             "statement": each.statement(dial, limit, ends, seeds, held)} for each in found]
