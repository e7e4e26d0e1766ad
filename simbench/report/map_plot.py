"""The map that a system made, seen from above: points and lines, and beside it the points alone."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection

from simbench.report.map_view import MapView
from simbench.report.plots import ESTIMATE, Plot
from simbench.report.svg import Drawing
from slam.geometry.arrays import Array

_POINT, _PATH, _LOOP = "#8a8a8a", "#d55e00", "#009e73"
_SHOWN = 95.0            # percent of the map, along each axis, that the figure reaches beyond
_MARGIN = 0.25           # of what those span: so far beyond them it still shows
_EDGE = 0.04             # and so far beyond the path
_AXES = "xyz"


def map_plots(seen: MapView | None) -> list[Plot]:
    """Two figures of one extent: with lines, and without; one where there are none."""
    if seen is None:
        return []
    across, up = plane_of(seen)
    what = (f"{_AXES[across]}–{_AXES[up]} plane of the world in metres, axes to scale; orange: the "
            "camera's path")
    loops = f"; green rings: loops closed ({len(seen.loops)})" if len(seen.loops) else ""
    plots = [Plot(_drawn(seen, across, up, with_lines), f"map: {title}",
                  f"{len(seen.points)} points{also}. {what}{loops}.",
                  f"Map of {len(seen.points)} points{also}, seen along one axis")
             for with_lines, title, also in (
                 (True, "points and lines", f" (grey) and {len(seen.lines)} lines (blue)"),
                 (False, "points alone", " (grey)"))]
    return plots if len(seen.lines) else plots[1:]


def plane_of(seen: MapView) -> tuple[int, int]:
    """The two axes in which the map reaches farthest: a floor plan, of most places."""
    low, high = _reach(seen)
    across, up = sorted(np.argsort(high - low, kind="stable")[-2:].tolist())
    return across, up


def _reach(seen: MapView) -> tuple[Array, Array]:
    """(3,) least and greatest coordinates of most of the map and of all of the path."""
    whole = np.concatenate([seen.points, seen.lines.reshape(-1, 3)])
    low, high = np.percentile(whole, [100.0 - _SHOWN, _SHOWN], axis=0)
    margin = _MARGIN * (high - low)
    low, high = low - margin, high + margin
    edge = _EDGE * np.maximum(high - low, np.ptp(seen.path, axis=0))
    return (np.minimum(low, seen.path.min(axis=0) - edge),
            np.maximum(high, seen.path.max(axis=0) + edge))


def _drawn(seen: MapView, across: int, up: int, with_lines: bool) -> str:
    low, high = _reach(seen)
    drawing = Drawing(4.4, 3.6)
    with drawing as figure:
        axes = figure.add_subplot()
        # Thousands of marks: as pixels within the drawing.
        axes.plot(seen.points[:, across], seen.points[:, up], ".", color=_POINT, markersize=2.0,
                  markeredgecolor="none", rasterized=True)
        if with_lines:
            axes.add_collection(LineCollection(
                list(seen.lines[:, :, [across, up]]), colors=ESTIMATE, linewidths=0.7,
                rasterized=True))
        axes.plot(seen.path[:, across], seen.path[:, up], color=_PATH, linewidth=1.2)
        axes.plot(seen.loops[:, across], seen.loops[:, up], "o", markersize=8.0,
                  markerfacecolor="none", markeredgecolor=_LOOP, markeredgewidth=1.5)
        axes.set_xlim(low[across], high[across])
        axes.set_ylim(low[up], high[up])
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel(f"{_AXES[across]} (m)")
        axes.set_ylabel(f"{_AXES[up]} (m)")
    return drawing.svg
