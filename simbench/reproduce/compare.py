"""One system against another, in the paper and here; and whether a quantity goes with the gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simbench.reproduce.measured import Measured
from simbench.reproduce.table import Comparison, Correlation, PaperTable, Quantity, Row
from simbench.statistics import Interval, mean_interval, rank_correlation, seeds_needed
from simbench.suites.results import RESOLUTION


@dataclass(frozen=True, slots=True)
class Ratio:
    """The second system's values as a share of the first's: below 1 they are smaller."""

    mean: float              # geometric, over the seeds that both have
    low: float | None
    high: float | None
    n: int
    seeds_needed: int | None


@dataclass(frozen=True, slots=True)
class RowRatio:
    """A row's ratio, as printed and as measured; None where either value is missing."""

    row: str
    printed: float | None
    ours: Ratio | None


@dataclass(frozen=True, slots=True)
class Compared:
    """A comparison over all rows, and their geometric mean."""

    comparison: Comparison
    rows: tuple[RowRatio, ...]
    all_rows: RowRatio


@dataclass(frozen=True, slots=True)
class GainPoint:
    """A row of a correlation: the quantity, and the gain in percent."""

    row: str
    quantity: float
    gain_percent: float


@dataclass(frozen=True, slots=True)
class Correlated:
    """Spearman's ρ over the rows, in the paper's numbers and in ours."""

    correlation: Correlation
    printed: tuple[GainPoint, ...]
    ours: tuple[GainPoint, ...]
    rho_printed: Interval | None
    rho_ours: Interval | None


def compare(table: PaperTable, comparison: Comparison, measured: Measured) -> Compared | None:
    """The ratios of every row. None where a system to compare was not run."""
    if not set(comparison.ours) <= measured.named.keys():
        return None
    logs = [_log_ratios(table, row, comparison, measured) for row in table.rows]
    printed = [_printed_ratio(table, i, comparison) for i in range(len(table.rows))]
    rows = tuple(RowRatio(row.name, p, _ratio(list(own.values())))
                 for row, p, own in zip(table.rows, printed, logs, strict=True))
    known = [p for p in printed if p is not None]
    there = [own for own in logs if own]
    everywhere = [seed for seed in (there[0] if there else {})
                  if all(seed in own for own in there)]
    overall = _ratio([float(np.mean([own[seed] for own in there])) for seed in everywhere])
    mean = float(np.exp(np.mean(np.log(known)))) if known and min(known) > 0 else None
    return Compared(comparison, rows, RowRatio("geometric mean", mean, overall))


def correlate(table: PaperTable, correlation: Correlation, measured: Measured
              ) -> Correlated | None:
    """The quantity against the gain of each row. None where a system was not run."""
    found = compare(table, correlation.gain_of, measured)
    if found is None or correlation.ours not in measured.named:
        return None
    quantity = quantity_of(table, correlation.quantity)
    column = table.column(correlation.printed, correlation.quantity)
    printed, ours = [], []
    for i, (row, ratio) in enumerate(zip(table.rows, found.rows, strict=True)):
        there = column.cells[i].value
        if there is not None and ratio.printed is not None:
            printed.append(GainPoint(row.name, there, 100.0 * (1.0 - ratio.printed)))
        here = list(measured.values(row, quantity,
                                    measured.named[correlation.ours]).values())
        if here and ratio.ours is not None:
            ours.append(GainPoint(row.name, float(np.mean(here)),
                                  100.0 * (1.0 - ratio.ours.mean)))
    return Correlated(correlation, tuple(printed), tuple(ours), _rho(printed), _rho(ours))


def quantity_of(table: PaperTable, name: str) -> Quantity:
    """The quantity of that name."""
    return next(each for each in table.quantities if each.name == name)


def _rho(points: Sequence[GainPoint]) -> Interval | None:
    return rank_correlation([p.quantity for p in points], [p.gain_percent for p in points])


def _log_ratios(table: PaperTable, row: Row, comparison: Comparison, measured: Measured
                ) -> dict[int, float]:
    quantity = quantity_of(table, comparison.quantity)
    first, second = (measured.values(row, quantity, measured.named[name])
                     for name in comparison.ours)
    return {seed: float(np.log(second[seed] / first[seed])) for seed in first
            if seed in second and first[seed] > 0 and second[seed] > 0}


def _ratio(logs: Sequence[float]) -> Ratio | None:
    if not logs:
        return None
    found = mean_interval(logs)
    low, high = (None if end is None else float(np.exp(end)) for end in (found.low, found.high))
    return Ratio(float(np.exp(found.mean)), low, high, found.n, seeds_needed(logs, RESOLUTION))


def _printed_ratio(table: PaperTable, i: int, comparison: Comparison) -> float | None:
    first, second = (table.column(system, comparison.quantity).cells[i].value
                     for system in comparison.printed)
    return None if not first or second is None else second / first
