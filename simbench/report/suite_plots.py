"""A suite's curves: an error against a dial, with its interval over the seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from simbench.metric_names import find_metric
from simbench.report.plots import ESTIMATE, PALETTE, Plot
from simbench.report.svg import Drawing
from simbench.report.table import shown_number
from slam.geometry.arrays import Array

COLOURS = (ESTIMATE, *PALETTE)
_MARKERS = "osD^vP*X"
_MANY_TIMES = 30.0     # a span beyond which an axis goes by powers of ten
_CROWDED = 0.12        # of the axis: dial values nearer than this are set at equal steps instead


def curve_plots(summary: Sequence[Mapping[str, Any]], meaning: Sequence[Mapping[str, Any]],
                dial: str, metrics: Sequence[str], systems: Sequence[str],
                also: Mapping[str, Any], means: tuple[str, str, str] | None) -> list[Plot]:
    """One figure for each metric that has values at two points of the dial or more.

    Args:
        summary: of one case, at the points that share `also`.
        meaning: of the same points.
        dial: what is on the x axis; a number at every point.
        also: what else is swept, with its value here.
        means: (key of `meaning`, title, unit) to put below the dial's values.
    """
    plots = []
    for name in metrics:
        lines = {system: _line(summary, dial, name, system) for system in systems}
        lines = {system: line for system, line in lines.items() if len(line) > 1}
        if lines:
            plots.append(_plot(lines, systems, name, dial, also, meaning, means))
    return plots


def _line(summary: Sequence[Mapping[str, Any]], dial: str, metric: str, system: str) -> Array:
    """(N, 4): dial, mean, low and high; low and high are the mean where one seed is all."""
    rows = []
    for each in summary:
        if each["system"] == system and metric in each["metrics"]:
            m = each["metrics"][metric]
            rows.append((each["point"][dial], m["mean"],
                         m["mean"] if m["low"] is None else m["low"],
                         m["mean"] if m["high"] is None else m["high"]))
    return np.array(sorted(rows), dtype=np.float64).reshape(-1, 4)


def _plot(lines: Mapping[str, Array], systems: Sequence[str], name: str, dial: str,
          also: Mapping[str, Any], meaning: Sequence[Mapping[str, Any]],
          means: tuple[str, str, str] | None) -> Plot:
    metric = find_metric(name)
    small = metric.unit == "m" and max(np.nanmax(line[:, 1]) for line in lines.values()) < 0.1
    unit, scale = ("mm", 1e3) if small else (metric.unit, 1.0)
    values = sorted({float(x) for line in lines.values() for x in line[:, 0]})
    even = len(values) > 2 and min(np.diff(values)) < _CROWDED * (values[-1] - values[0])
    drawing = Drawing(4.4, 3.2)
    with drawing as figure:
        axes = figure.add_subplot()
        for system, line in lines.items():
            i = list(systems).index(system)
            colour = COLOURS[i % len(COLOURS)]
            x = np.searchsorted(values, line[:, 0]) if even else line[:, 0]
            y = line[:, 1:] * scale
            axes.fill_between(x, y[:, 1], y[:, 2], color=colour, alpha=0.18, linewidth=0)
            axes.plot(x, y[:, 0], color=colour, marker=_MARKERS[i % len(_MARKERS)],
                      markersize=4.0, label=system.replace("$", r"\$"))
        _scale(axes, np.concatenate(list(lines.values()))[:, 1:3] * scale, metric.better)
        axes.set_xticks(range(len(values)) if even else values)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticklabels(_tick_labels(values, dial, meaning, means))
        axes.set_xlabel(dial if means is None else
                        f"{dial}, and below: {means[1]} ({means[2]})")
        axes.set_ylabel(f"{name} ({unit})" if unit else name)
        if len(lines) > 1:
            figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center",
                          ncols=min(4, len(lines)))
    where = ", ".join(f"{k} = {v}" for k, v in also.items())
    title = f"{metric.help or name}" + (f", {where}" if where else "")
    return Plot(drawing.svg, title,
                f"{name}{f' in {unit}' if unit else ''} over {dial}; means over the seeds, bands: "
                "95 % by bootstrap.",
                f"{title}, over {dial}, for {', '.join(lines)}")


def _scale(axes: Axes, points: Array, better: str) -> None:
    """`points` (N, 2): means and lower ends."""
    means = points[:, 0]
    if better == "higher" and means.max() <= 1.0:
        axes.set_ylim(-0.03, 1.03)
    elif means.min() > 0 and means.max() > _MANY_TIMES * means.min():
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=min(0.0, float(points[:, 1].min())))


def _tick_labels(values: Sequence[float], dial: str, meaning: Sequence[Mapping[str, Any]],
                 means: tuple[str, str, str] | None) -> list[str]:
    """The dial's values, with what was measured below each."""
    labels = [f"{value:g}" for value in values]
    if means is None:
        return labels
    measured = {float(each["point"][dial]): each.get(means[0]) for each in meaning}
    return [f"{label}\n{shown_number(measured.get(value))}"
            for label, value in zip(labels, values, strict=True)]
