"""The printed numbers: as the papers' own text tells of them, and each with its counterpart."""

import numpy as np
import pytest

from simbench.errors import UnknownName
from simbench.reproduce.run_table import suite_of
from simbench.reproduce.table import Cell, list_tables, load_table
from simbench.suites.run_suite import check_names


@pytest.mark.parametrize("name", list_tables())
def test_every_row_and_comparison_has_its_counterpart(name):
    table = load_table(name)
    assert table.name == name
    suite = suite_of(table)
    check_names(suite)
    assert len(suite.seeds) >= 5
    assert {row.case for row in table.rows} <= {case.name for case in suite.cases}
    assert {column.quantity for column in table.columns} <= {q.name for q in table.quantities}
    compared = [*table.comparisons, *([table.correlation.gain_of] if table.correlation else [])]
    for each in compared:
        for system in each.printed:
            table.column(system, each.quantity)
        assert set(each.ours) <= {*suite.systems, "orbslam3_system"}    # an example file


@pytest.mark.parametrize("name", list_tables())
def test_a_deviation_is_no_larger_than_its_root_mean_square(name):
    cells = [cell for column in load_table(name).columns for cell in column.cells]
    assert all(cell.deviation <= cell.value for cell in cells if cell.deviation is not None)


def values(table, system, quantity):
    return np.array([np.nan if cell.value is None else cell.value
                     for cell in table.column(system, quantity).cells])


def test_the_boxes_add_up_to_their_means_and_to_the_gains_that_the_text_names():
    table = load_table("sdpl-table2")
    for system in ("VDO-SLAM", "SDPL-SLAM"):
        for quantity in ("E_t", "E_R"):
            column = values(table, system, quantity)
            assert column[3:7].mean() == pytest.approx(column[7], abs=0.00051)
    gains = {"E_t": (42, 9.4, 18, None, None, None, None, 6.3),
             "E_R": (12, 4.3, 2.8, None, None, None, None, 0.7)}
    for quantity, wanted in gains.items():
        gain = 100.0 * (1.0 - values(table, "SDPL-SLAM", quantity)
                        / values(table, "VDO-SLAM", quantity))
        for found, said in zip(gain, wanted, strict=True):
            assert said is None or found == pytest.approx(said, abs=0.5)


def test_the_drives_are_as_the_text_tells_of_them():
    table = load_table("sdpl-table1")
    length = values(table, "w. FO", "static line tracklet length")
    assert length.mean() == pytest.approx(6.0, abs=0.01)      # "the overall average (6)"
    ours, vdo = (values(table, system, "camera E_t") for system in ("w. FO", "VDO-SLAM"))
    names = [row.name for row in table.rows]
    worse = {names[i] for i in np.flatnonzero(ours > vdo)}
    assert worse == {"0926-0014", "0926-0101"}                # "underperforms slightly in"
    objects, theirs = (values(table, s, "objects E_t") for s in ("w. FO", "VDO-SLAM"))
    assert {names[i] for i in np.flatnonzero(objects > theirs)} \
        == {"0926-0002", "0926-0005", "0926-0013"}            # "does not improve are"
    assert np.all(length > values(table, "wo. FO", "static line tracklet length"))


def test_the_systems_own_column_agrees_between_the_office_tables():
    first, *others = (load_table(f"dpl-table{n}") for n in (1, 2, 3, 4))
    for other in others:
        assert [cell.text for cell in other.column("Ours", "ATE").cells] \
            == [cell.text for cell in first.column("Ours", "ATE").cells]


def test_a_cell_is_a_number_with_or_without_its_deviation():
    assert (Cell.parse("0.018 (0.009)").value, Cell.parse("0.018 (0.009)").deviation) \
        == (0.018, 0.009)
    assert (Cell.parse("0.325 (-)").value, Cell.parse("0.325 (-)").deviation) == (0.325, None)
    assert Cell.parse("-").value is None
    for wrong in ("", "1,2", "0.1 (0.2", "x"):
        with pytest.raises(ValueError, match="no number"):
            Cell.parse(wrong)


def test_an_unknown_table_is_answered_with_all_there_are():
    with pytest.raises(UnknownName, match=r"did you mean 'sdpl-table1'.*dpl-table6, sdpl-table1"):
        load_table("sdpl-tabel1")


def test_frames_scale_every_sequence_alike():
    suite = suite_of(load_table("sdpl-table2"), frames=1000, seeds=(0, 1), size=(64, 48))
    assert [case.frames for case in suite.cases] == [1000, 500]
    assert suite.seeds == (0, 1)
    assert {case.size for case in suite.cases} == {(64, 48)}
