"""A paper's table as its YAML file in the package says it: what is printed, what stands beside."""

from __future__ import annotations

import difflib
import importlib.resources
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from simbench.errors import UnknownName

_CELL = re.compile(r"(?P<value>\d+(?:\.\d+)?)(?: \((?P<deviation>\d+(?:\.\d+)?|-)\))?")


@dataclass(frozen=True, slots=True)
class Cell:
    """A number as it is printed."""

    text: str                    # "0.018 (0.009)"; "-" where nothing stands
    value: float | None
    deviation: float | None

    @classmethod
    def parse(cls, text: str) -> Cell:
        """From a value, and its standard deviation in brackets. Raises ValueError."""
        if text == "-":
            return cls(text, None, None)
        match = _CELL.fullmatch(text)
        if match is None:
            raise ValueError(f"{text!r} is no number with a deviation in brackets")
        deviation = match["deviation"]
        return cls(text, float(match["value"]),
                   None if deviation in (None, "-") else float(deviation))


@dataclass(frozen=True, slots=True)
class Column:
    """A printed column: one system's values of one quantity, one for each row."""

    system: str
    quantity: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Quantity:
    """What we measure beside the columns of that name."""

    name: str
    unit: str
    metric: str                  # below the row's `of` in metrics.json
    deviation: str = ""          # the metric of its standard deviation over the frames
    scale: float = 1.0           # from the metric's unit to this one


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the paper, and where its counterpart is found."""

    name: str
    case: str                    # of the suite
    of: str = ""                 # block of metrics.json: "camera", "objects.1"; "" for all of it


@dataclass(frozen=True, slots=True)
class Comparison:
    """The second system against the first, in one quantity, in the paper and here.

    Ours go by their short names; what was not run is not compared.
    """

    quantity: str
    printed: tuple[str, str]
    ours: tuple[str, str]


@dataclass(frozen=True, slots=True)
class Correlation:
    """Does a quantity go with the gain of one system over another, over the rows?"""

    quantity: str
    printed: str                 # the system that the quantity is read of
    ours: str
    gain_of: Comparison


@dataclass(frozen=True, slots=True)
class PaperTable:
    """All of a table."""

    name: str
    title: str
    suite: str
    data: str                    # what the printed numbers were measured on
    columns: tuple[Column, ...]
    notes: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    rows: tuple[Row, ...]
    comparisons: tuple[Comparison, ...] = ()
    correlation: Correlation | None = None
    figure: str = ""             # "deviation": of a camera that stands still, over time

    def column(self, system: str, quantity: str) -> Column:
        """The printed column. Raises KeyError."""
        for each in self.columns:
            if (each.system, each.quantity) == (system, quantity):
                return each
        raise KeyError(f"{self.name}: no column {system} of {quantity}")

    @property
    def measures_time(self) -> bool:
        """Whether other processes at the same time would falsify it."""
        return any(each.metric.startswith("timing.") for each in self.quantities)


def list_tables() -> list[str]:
    """The names of all tables."""
    return sorted(path.name.removesuffix(".yaml") for path in _folder().iterdir()
                  if path.name.endswith(".yaml"))


def load_table(name: str) -> PaperTable:
    """A table by name. Raises UnknownName, which names them all."""
    known = list_tables()
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}? There" if close else "; there"
        raise UnknownName(f"no table {name!r}{hint} are {', '.join(known)}")
    return _table(yaml.safe_load((_folder() / f"{name}.yaml").read_text(encoding="utf-8")))


def _folder() -> Any:
    return importlib.resources.files("simbench.reproduce") / "tables"


def _table(value: Mapping[str, Any]) -> PaperTable:
    printed, ours = value["printed"], value["ours"]
    cells = [[Cell.parse(text) for text in row] for row in printed["rows"].values()]
    columns = tuple(Column(each["system"], each["quantity"], tuple(row[i] for row in cells))
                    for i, each in enumerate(printed["columns"]))
    if any(len(row) != len(columns) for row in cells) or list(ours["rows"]) != [*printed["rows"]]:
        raise ValueError(f"{value['name']}: rows and columns do not fit")
    correlate = value.get("correlate")
    return PaperTable(
        name=value["name"], title=value["title"], suite=value["suite"], data=printed["data"],
        columns=columns, notes=tuple(printed.get("notes", ())),
        quantities=tuple(Quantity(name, **each) for name, each in ours["quantities"].items()),
        rows=tuple(Row(name, **each) for name, each in ours["rows"].items()),
        comparisons=tuple(_comparison(each) for each in value.get("compare", ())),
        correlation=None if correlate is None else Correlation(
            correlate["quantity"], correlate["printed"], correlate["ours"],
            _comparison(correlate["gain_of"])),
        figure=value.get("figure", ""))


def _comparison(value: Mapping[str, Any]) -> Comparison:
    return Comparison(value["quantity"], tuple(value["printed"]), tuple(value["ours"]))
