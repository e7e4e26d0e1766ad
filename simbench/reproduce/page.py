"""A reproduced table as one self-contained HTML page."""

from __future__ import annotations

from importlib import metadata

import jinja2
from matplotlib.axes import Axes

from simbench.report.page import indices
from simbench.report.plots import ESTIMATE, PALETTE, Plot
from simbench.report.svg import INK, Drawing
from simbench.reproduce.compare import Correlated
from simbench.reproduce.measured import AXES, Deviation, short_name
from simbench.reproduce.side_by_side import (
    Reproduction,
    correlation_lines,
    inputs_text,
    over_seeds,
)

_COLOURS = (ESTIMATE, *PALETTE)
_TOWARD = ("right", "down", "forward")


def render(found: Reproduction) -> str:
    """The page. It links to report.html, the page of the suite beside it."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("simbench.report", "templates"),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["indices"] = indices
    plots = [] if found.correlated is None else [_correlation_plot(found.correlated)]
    plots += [_deviation_plot(i, found.deviations) for i in range(3) if found.deviations]
    return environment.get_template("reproduce.html.j2").render(
        table=found.table, suite=found.suite, inputs=inputs_text(found.suite), sides=found.sides,
        over_seeds=over_seeds(found.suite),
        counterparts=found.counterparts, comparisons=found.comparisons,
        counts=found.counts, plots=plots,
        correlation=() if found.correlated is None else correlation_lines(found.correlated),
        version=metadata.version("simbench-slam"))


def _correlation_plot(found: Correlated) -> Plot:
    c = found.correlation
    drawing = Drawing(4.4, 3.2)
    with drawing as figure:
        axes: Axes = figure.add_subplot()
        for points, label, colour, marker in (
                (found.printed, "printed, other data", INK, "x"),
                (found.ours, "ours", ESTIMATE, "o")):
            axes.plot([p.quantity for p in points], [p.gain_percent for p in points], marker,
                      color=colour, label=label, markersize=4.5)
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_xlabel(c.quantity)
        axes.set_ylabel("gain (%)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    title = f"gain in {c.gain_of.quantity} against {c.quantity}"
    return Plot(drawing.svg, title, "One mark for each sequence; above 0 lines helped.", title)


def _deviation_plot(axis: int, deviations: tuple[Deviation, ...]) -> Plot:
    drawing = Drawing(4.4, 2.6)
    with drawing as figure:
        axes = figure.add_subplot()
        for i, each in enumerate(deviations):
            axes.plot(each.time_s, 1e3 * each.offset_m[:, axis],
                      color=_COLOURS[i % len(_COLOURS)], label=short_name(each.system))
        axes.set_xlabel("time (s)")
        axes.set_ylabel(f"{AXES[axis]} (mm)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    title = f"deviation in {AXES[axis]}, {_TOWARD[axis]}"
    return Plot(drawing.svg, title, "The camera stands still: all of it is error. First seed.",
                f"{title}, of {', '.join(short_name(d.system) for d in deviations)}")
