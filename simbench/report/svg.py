"""Matplotlib figures as inline SVG that takes the page's ink, so that it suits light and dark."""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

INK = "#010203"     # stands for the page's text colour
GRID = "#040506"    # and for its faint rules
_PIXELS_PER_INCH = 220   # of what is drawn as pixels within a figure
_STYLE: Any = {
    "svg.fonttype": "none", "svg.hashsalt": "simbench", "font.size": 9.0,
    "font.family": "sans-serif", "text.color": INK, "axes.labelcolor": INK,
    "axes.edgecolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.6,
    "axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.6, "axes.axisbelow": True,
    "legend.frameon": False, "legend.fontsize": 8.0, "axes.titlesize": 9.0,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "lines.linewidth": 1.4,
    "axes.formatter.useoffset": False, "axes.formatter.limits": (-4, 5),
}


class Drawing:
    """`with Drawing(...) as figure:` draws; `svg` holds the result afterwards."""

    def __init__(self, width_in: float = 4.4, height_in: float = 2.8) -> None:
        self._size = (width_in, height_in)
        self._context = mpl.rc_context(_STYLE)
        self.svg = ""

    def __enter__(self) -> Figure:
        self._context.__enter__()
        self._figure = Figure(figsize=self._size, layout="constrained", dpi=_PIXELS_PER_INCH)
        FigureCanvasSVG(self._figure)
        return self._figure

    def __exit__(self, *raised: Any) -> None:
        if raised[0] is None:
            self.svg = _inline(self._figure)
        self._context.__exit__(*raised)


def _inline(figure: Figure) -> str:
    """The <svg> element alone, its size left to the page."""
    out = io.StringIO()
    figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg"):]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", text)
    return text.replace(INK, "currentColor").replace(GRID, "var(--rule)")
