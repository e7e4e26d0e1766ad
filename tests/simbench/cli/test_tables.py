"""Tables in the terminal: wide ones come in parts that fit it."""

from __future__ import annotations

import re

from simbench.cli.error_table import parts_that_fit, print_table
from simbench.report.table import ErrorTable

WIDE = ErrorTable(("", "first", "second", "third"), (("boxes", "1", "2", "3" * 30),), ())


def test_a_table_is_split_into_parts_no_wider_than_the_terminal():
    assert parts_that_fit(WIDE, 100) == [WIDE]
    first, second = parts_that_fit(WIDE, 40)
    assert (first.columns, first.rows) == (("", "first", "second"), (("boxes", "1", "2"),))
    assert second.columns == ("", "third")      # wider than the rest, with the first column
    assert [part.columns[1] for part in parts_that_fit(WIDE, 1)] == ["first", "second", "third"]


def test_into_a_pipe_a_table_is_whole(capsys):
    print_table(WIDE)
    assert any("boxes" in line and "3" * 30 in line and " 2 " in line
               for line in capsys.readouterr().out.splitlines())


def test_in_a_terminal_no_line_is_longer_than_it(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "44")
    print_table(WIDE)
    shown = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out)     # without what makes it bold
    assert max(map(len, shown.splitlines())) <= 44
