"""Hold a run or a suite against its baseline, in pairs of equal sequences.

A change for the worse is a regression when the whole interval of its mean lies beyond what the
metric tolerates. All sequences together, by system, are held to the tolerance itself; a single
cell of a suite (its seeds alone) to 2.5 times as much: few seeds, and many cells that may err.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from simbench.baseline import Baseline, BlessedRun
from simbench.errors import UserError
from simbench.metric_names import Metric
from simbench.report.table import shown_number
from simbench.statistics import Interval, mean_interval
from simbench.suites.spec import point_text

_OF_A_CELL = 2.5     # times the tolerance

Pair = tuple[BlessedRun, BlessedRun]     # before, now


@dataclass(frozen=True, slots=True)
class Change:
    """How a metric changed for the worse (above 0) over some pairs of runs."""

    metric: Metric
    system: str
    where: str
    old: float
    new: float
    worse_by: Interval
    tolerance: float
    worst: str               # the sequence that lost most

    @property
    def regressed(self) -> bool:
        low = self.worse_by.mean if self.worse_by.low is None else self.worse_by.low
        return low > self.tolerance

    @property
    def improved(self) -> bool:
        high = self.worse_by.mean if self.worse_by.high is None else self.worse_by.high
        return high < -self.tolerance

    def __str__(self) -> str:
        m, c = self.metric, self.worse_by
        scale, unit = (1e3, "mm") if m.unit == "m" else (1.0, m.unit)
        percent, sign = (100.0, " %") if m.relative else (scale, f" {unit}" if unit else "")
        turn = 1.0 if m.better == "lower" else -1.0
        ends = sorted(turn * percent * end for end in (c.low, c.high) if end is not None)
        interval = f" [{ends[0]:+.3g}, {ends[1]:+.3g}]" if ends else ""
        seeds = f"{c.n} sequences" if c.n > 1 else "1 sequence"
        return (f"{m.name} of {self.system} on {self.where}: "
                f"{shown_number(self.new, scale)} {unit}".rstrip()
                + f", was {shown_number(self.old, scale)} {unit}".rstrip()
                + f": {turn * percent * c.mean:+.3g}{sign}{interval} over {seeds}, "
                f"{percent * self.tolerance:g}{sign} tolerated; worst on {self.worst}")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a gate found."""

    compared: int
    regressions: tuple[Change, ...]
    improvements: tuple[Change, ...]
    lost: tuple[str, ...]            # runs that came through before, and do not now
    other_bytes: tuple[str, ...]     # runs that were given other bytes than before

    @property
    def passed(self) -> bool:
        return not self.regressions and not self.lost


def judge(baseline: Baseline, now: Baseline) -> Verdict:
    """Compare what came out now with the baseline.

    Raises:
        UserError: they are not of the same sequences (another suite, scene, dial, seed or input),
            or share nothing that can be compared.
    """
    pairs = _paired(baseline, now)
    changes = list(_changes(baseline.metrics, pairs))
    lost = [f"{_name(new)}: {new.status}" for old, new in pairs
            if old.status == "done" and new.status != "done"]
    lost += [f"{_name(new)}: no {name} any more" for old, new in pairs if new.status == "done"
             for name in old.values if name not in new.values]
    if not changes and not lost:
        raise UserError(f"nothing of {now.name} can be compared with the baseline: they share no "
                        "measured metric; run more frames and bless anew")
    return Verdict(len(changes), tuple(c for c in changes if c.regressed),
                   tuple(c for c in changes if c.improved), tuple(lost),
                   tuple(_name(new) for old, new in pairs
                         if old.given_sha256 != new.given_sha256))


def _paired(baseline: Baseline, now: Baseline) -> list[Pair]:
    if baseline.name != now.name:
        raise UserError(f"the baseline is of {baseline.name}, this is {now.name}; compare the "
                        "same, or bless anew")
    old, new = ({(*run.cell, run.seed): run for run in each.runs} for each in (baseline, now))
    systems = {run.system for run in baseline.runs}
    new = {key: run for key, run in new.items() if run.system in systems}
    missing, more = [key for key in old if key not in new], [key for key in new if key not in old]
    if missing:
        raise UserError(f"the baseline has {_name(old[missing[0]])}, and this has not; run the "
                        "same cases, systems and seeds, or bless anew")
    if more:
        raise UserError(f"{_name(new[more[0]])} is not in the baseline; run the same cases and "
                        "seeds, or bless anew")
    for key, run in old.items():
        _check_asked(run, new[key])
    return [(run, new[key]) for key, run in old.items()]


def _check_asked(old: BlessedRun, new: BlessedRun) -> None:
    for key in sorted({*old.asked, *new.asked}):
        if old.asked.get(key) != new.asked.get(key):
            raise UserError(f"{_name(new)}: {key} is {new.asked.get(key)!r}, in the baseline "
                            f"{old.asked.get(key)!r}; run it as it was, or bless anew")


def _changes(metrics: Sequence[Metric], pairs: Sequence[Pair]) -> Iterator[Change]:
    for system, of_system in _grouped(pairs, lambda run: run.system).items():
        cells = _grouped(of_system, lambda run: repr(run.cell))
        for metric in metrics:
            both = [p for p in of_system if all(metric.name in run.values for run in p)]
            if len(both) > 1:
                yield _change(metric, system, "all sequences", both, metric.tolerance)
            for cell in cells.values():
                inside = [p for p in cell if p in both]
                if inside and (len(cells) > 1 or len(inside) == 1):
                    yield _change(metric, system, _where(inside[0][0]), inside,
                                  _OF_A_CELL * metric.tolerance)


def _grouped(pairs: Iterable[Pair], key: Callable[[BlessedRun], str]
             ) -> Mapping[str, list[Pair]]:
    groups: dict[str, list[Pair]] = {}
    for pair in pairs:
        groups.setdefault(key(pair[0]), []).append(pair)
    return groups


def _change(metric: Metric, system: str, where: str, pairs: Sequence[Pair],
            tolerance: float) -> Change:
    old = [before.values[metric.name] for before, _ in pairs]
    new = [after.values[metric.name] for _, after in pairs]
    worse = [metric.worsening(a, b) for a, b in zip(old, new, strict=True)]
    worst = pairs[max(range(len(worse)), key=worse.__getitem__)][1]
    return Change(metric, system, where, sum(old) / len(old), sum(new) / len(new),
                  mean_interval(worse), tolerance, f"{_where(worst)} seed {worst.seed}")


def _where(run: BlessedRun) -> str:
    return f"{run.case} {point_text(tuple(run.point.items()))}".strip()


def _name(run: BlessedRun) -> str:
    return f"{_where(run)} {run.system} seed {run.seed}"
