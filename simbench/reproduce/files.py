"""A reproduced table as Markdown, and its numbers as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence

from simbench.report.table import ErrorTable
from simbench.reproduce.measured import Measured
from simbench.reproduce.side_by_side import (
    Reproduction,
    SideTable,
    correlation_lines,
    inputs_text,
    over_seeds,
)
from simbench.reproduce.table import PaperTable
from simbench.statistics import mean_interval

_HEAD = ("row", "quantity", "unit", "source", "system", "value", "low", "high", "n", "deviation")


def markdown(found: Reproduction) -> str:
    """The whole as one Markdown text."""
    return "\n".join(_blocks(found)) + "\n"


def _blocks(found: Reproduction) -> Iterator[str]:
    table = found.table
    yield f"# {table.title}\n"
    yield (f"*Printed* columns are the paper's, measured on other data ({table.data}). The others "
           f"are ours, on synthetic counterparts (suite `{found.suite.name}`, "
           f"{inputs_text(found.suite)}), {over_seeds(found.suite)}.\n")
    yield from _error_table(found.counterparts)
    for side in found.sides:
        yield f"## {side.title}\n"
        yield from _rows(_headings(side), side.rows)
        yield from (f"\n{note}" for note in side.notes)
        yield ""
    for each in found.comparisons:
        yield f"## One against the other: {each.columns[0]}\n"
        yield from _error_table(each)
    if found.correlated is not None:
        yield "## Tracklets and gain\n"
        yield from (f"* {line}" for line in correlation_lines(found.correlated))
        yield ""
    yield "## Frames without an answer\n"
    yield from _error_table(found.counts)
    if table.notes:
        yield "## On the printed numbers\n"
        yield from (f"* {note}" for note in table.notes)


def _headings(side: SideTable) -> tuple[str, ...]:
    return ("", *(f"*printed: {each}*" for each in side.printed), *side.ours)


def _error_table(table: ErrorTable) -> Iterator[str]:
    yield from _rows(("", *table.columns[1:]), table.rows)
    yield from (f"\n{note}" for note in table.notes)
    yield ""


def _rows(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(columns) + " |"
    yield "|---" * len(columns) + "|"
    for row in rows:
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"


def numbers_csv(table: PaperTable, measured: Measured) -> str:
    """One line for each printed number, and for each of ours."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_HEAD)
    units = {each.name: each.unit for each in table.quantities}
    for column in table.columns:
        for row, cell in zip(table.rows, column.cells, strict=True):
            if cell.value is not None:
                writer.writerow((row.name, column.quantity, units[column.quantity], "printed",
                                 column.system, cell.value, "", "", "",
                                 "" if cell.deviation is None else cell.deviation))
    for quantity in table.quantities:
        for row in table.rows:
            for system in measured.systems:
                values = list(measured.values(row, quantity, system).values())
                if not values:
                    continue
                found = mean_interval(values)
                spreads = list(measured.spreads(row, quantity, system).values())
                writer.writerow((
                    row.name, quantity.name, quantity.unit, "measured", system, found.mean,
                    *("" if end is None else end for end in (found.low, found.high)), found.n,
                    sum(spreads) / len(spreads) if spreads else ""))
    return out.getvalue()
