"""A table's content as text: the paper's columns, then ours, for each quantity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simbench.report.table import NONE, ErrorTable, shown_number
from simbench.reproduce.compare import Compared, Correlated, Ratio, compare, correlate
from simbench.reproduce.measured import Deviation, Measured, short_name
from simbench.reproduce.table import PaperTable, Quantity, Row
from simbench.statistics import Interval, mean_interval
from simbench.suites.results import RESOLUTION
from simbench.suites.spec import Case, Suite, value_text


@dataclass(frozen=True, slots=True)
class Reproduction:
    """All that the page and the Markdown say."""

    table: PaperTable
    suite: Suite
    sides: tuple[SideTable, ...]
    counterparts: ErrorTable
    counts: ErrorTable
    comparisons: tuple[ErrorTable, ...]
    correlated: Correlated | None
    deviations: tuple[Deviation, ...]


@dataclass(frozen=True, slots=True)
class SideTable:
    """One quantity: printed columns (other data), then ours (the counterpart)."""

    title: str
    printed: tuple[str, ...]     # headings
    ours: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]    # name, printed, ours
    notes: tuple[str, ...] = ()

    def flat(self) -> ErrorTable:
        """As one table."""
        return ErrorTable((self.title, *(f"printed: {each}" for each in self.printed), *self.ours),
                          self.rows, self.notes)


def reproduction(table: PaperTable, suite: Suite, measured: Measured) -> Reproduction:
    """Everything in one place."""
    compared = [compare(table, each, measured) for each in table.comparisons]
    return Reproduction(
        table, suite,
        tuple(_side(table, quantity, measured) for quantity in table.quantities),
        _counterparts(table, suite), _counts(table, measured),
        tuple(_comparison_table(each) for each in compared if each is not None),
        None if table.correlation is None else correlate(table, table.correlation, measured),
        tuple(measured.deviations))


def _counterparts(table: PaperTable, suite: Suite) -> ErrorTable:
    """What of which scene stands for each row of the paper."""
    cases = {case.name: case for case in suite.cases}
    rows = []
    for row in table.rows:
        case = cases[row.case]
        dials = ", ".join(f"{name} {value_text(value)}" for name, value in case.dials.items())
        rows.append((row.name, case.scene, dials, str(case.frames), row.of))
    columns = ("", "scene", "dials", "frames", "errors of")
    kept = [i for i in range(len(columns)) if i == 0 or any(row[i] for row in rows)]
    return ErrorTable(tuple(columns[i] for i in kept),
                      tuple(tuple(row[i] for i in kept) for row in rows), ())


def _side(table: PaperTable, quantity: Quantity, measured: Measured) -> SideTable:
    columns = [each for each in table.columns if each.quantity == quantity.name]
    rows = tuple((row.name, *(c.cells[i].text for c in columns),
                  *(_own_cell(row, quantity, system, measured) for system in measured.systems))
                 for i, row in enumerate(table.rows))
    notes = ("In brackets behind the interval: standard deviation over the frames.",) \
        if quantity.deviation else ()
    return SideTable(f"{quantity.name} ({quantity.unit})",
                     tuple(each.system for each in columns),
                     tuple(short_name(each) for each in measured.systems), rows, notes)


def _own_cell(row: Row, quantity: Quantity, system: str, measured: Measured) -> str:
    values = list(measured.values(row, quantity, system).values())
    if not values:
        return NONE
    found = mean_interval(values)
    text = shown_number(found.mean)
    if found.low is not None:
        text += f" [{shown_number(found.low)}, {shown_number(found.high)}]"
    spreads = list(measured.spreads(row, quantity, system).values())
    if spreads:
        text += f" ({shown_number(float(np.mean(spreads)))})"
    runs = measured.counted(row.case, system).runs
    return text if found.n == runs else f"{text}, {found.n} of {runs} runs"


def _counts(table: PaperTable, measured: Measured) -> ErrorTable:
    cases = dict.fromkeys(row.case for row in table.rows)
    rows = []
    for case in cases:
        cells = []
        for system in measured.systems:
            found = measured.counted(case, system)
            lost = f", {found.lost_runs} of {found.runs} runs lost" if found.lost_runs else ""
            cells.append(f"{found.lost_frames} of {found.frames}{lost}")
        rows.append((case, *cells))
    return ErrorTable(("", *(short_name(each) for each in measured.systems)), tuple(rows), (
        "An error is of the frames that have an estimate; these had none.",))


def _comparison_table(found: Compared) -> ErrorTable:
    c = found.comparison
    first, second = c.ours
    rows = tuple((each.row, NONE if each.printed is None else f"{each.printed:.3f}",
                  *_ratio_cells(each.ours)) for each in (*found.rows, found.all_rows))
    return ErrorTable(
        (f"{c.quantity}", f"printed: {c.printed[1]} / {c.printed[0]}",
         f"ours: {second} / {first}", "seeds", f"seeds for {100 * RESOLUTION:g} %"), rows, (
            "Ratios of the second system to the first; ours geometric means over pairs of equal "
            "sequences with 95 % intervals by bootstrap. Where the interval does not hold 1, the "
            f"two differ. “Seeds for {100 * RESOLUTION:g} %”: how many would make the ratio known "
            f"to ± {100 * RESOLUTION:g} %, by the spread seen here.",))


def _ratio_cells(ratio: Ratio | None) -> tuple[str, str, str]:
    if ratio is None:
        return NONE, "0", NONE
    interval = "" if ratio.low is None else f" [{ratio.low:.3f}, {ratio.high:.3f}]"
    needed = ratio.seeds_needed
    return f"{ratio.mean:.3f}{interval}", str(ratio.n), NONE if needed is None else str(needed)


def correlation_lines(found: Correlated) -> tuple[str, ...]:
    """What the correlation says, in sentences."""
    c = found.correlation
    what = f"{c.quantity} and gain in {c.gain_of.quantity} over {c.gain_of.printed[0]}"
    return (f"Printed: ρ = {_rho_text(found.rho_printed)} between {what}.",
            f"Ours: ρ = {_rho_text(found.rho_ours)} between {c.quantity} and gain in "
            f"{c.gain_of.quantity} over {c.gain_of.ours[0]}.",
            "Spearman's rank correlation over the sequences, with its 95 % interval by bootstrap; "
            "where the interval holds 0, these sequences show none.")


def _rho_text(rho: Interval | None) -> str:
    if rho is None:
        return "unknown (fewer than four rows)"
    return f"{rho.mean:+.2f} [{rho.low:+.2f}, {rho.high:+.2f}], {rho.n} sequences"


def over_seeds(suite: Suite) -> str:
    """Of what our numbers are means."""
    n = len(suite.seeds)
    return f"means over {n} seeds with 95 % intervals by bootstrap" if n > 1 else \
        "of one seed, so without intervals"


def inputs_text(suite: Suite) -> str:
    """What all cases of the suite share."""
    def shared(values: Sequence[Any]) -> bool:
        return all(each == values[0] for each in values)

    first: Case = suite.cases[0]
    words = [f"{name} {value_text(value)}" for name, value in first.inputs.items()
             if shared([case.inputs.get(name) for case in suite.cases])]
    if first.size is not None and shared([case.size for case in suite.cases]):
        words.insert(0, f"{first.size[0]}×{first.size[1]}")
    return ", ".join(words)
