"""Which part of an error comes from which input: what replacing each by a worse one costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simbench.metric_names import find_metric
from simbench.report.table import NONE, ErrorTable
from simbench.statistics import mean_interval

_INPUTS = ("flow", "masks", "boxes", "depth", "sensor")


def ladder_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[str],
                 systems: Sequence[str], no_objects_from: Sequence[str] = ()
                 ) -> ErrorTable | None:
    """For each input that is swept: how the metrics change from its first value to each other.

    Pairs of runs that differ in nothing but this input, over all seeds and all values of the
    other inputs. None where no input is swept. A dash stands for the objects of the systems of
    `no_objects_from`, which estimate none.
    """
    swept = {name: list(dict.fromkeys(run["point"][name] for run in runs))
             for name in _INPUTS if runs and name in runs[0]["point"]}
    swept = {name: values for name, values in swept.items() if len(values) > 1}
    if not swept:
        return None
    rows = [(f"{name}: {values[0]} → {value}, {system}",
             *(NONE if metric.startswith("objects") and system in no_objects_from else
               _change(runs, name, values[0], value, system, metric) for metric in metrics))
            for name, values in swept.items() for value in values[1:] for system in systems]
    return ErrorTable(("", *metrics), tuple(rows), (
        "Changes of each metric when this input alone is replaced, means over all seeds and all "
        "combinations of the others, with 95 % intervals.",))


def _change(runs: Sequence[Mapping[str, Any]], name: str, before: Any, after: Any, system: str,
            metric: str) -> str:
    def rest(run: Mapping[str, Any]) -> str:
        return repr((run["seed"], {k: v for k, v in run["point"].items() if k != name}))

    def values(wanted: Any) -> dict[str, float]:
        return {rest(run): run["metrics"][metric] for run in runs
                if run["system"] == system and run["point"][name] == wanted
                and metric in run.get("metrics", {})}

    old, new = values(before), values(after)
    changes = [new[key] - old[key] for key in old if key in new]
    if not changes:
        return NONE
    found = mean_interval(changes)
    unit = find_metric(metric).unit
    scale, shown = (1e3, " mm") if unit == "m" else (1.0, f" {unit}" if unit else "")
    interval = "" if found.low is None or found.high is None else \
        f" [{scale * found.low:+.3g}, {scale * found.high:+.3g}]"
    return f"{scale * found.mean:+.3g}{shown}{interval}"
