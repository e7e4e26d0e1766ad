"""docs/paper_map.md names functions and tests that exist."""

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROWS = [line for line in (ROOT / "docs/paper_map.md").read_text().splitlines()
        if line.startswith("|") and "`" in line]


@pytest.mark.parametrize("row", ROWS)
def test_function_and_test_exist(row):
    *_, function, test = re.findall(r"`([^`]+)`", row)
    module, name = function.rsplit(".", 1)
    assert callable(getattr(import_module(module), name))
    text = (ROOT / test).read_text()
    # Some stages are tested by running the whole system.
    assert re.search(rf"\b{name}\b", text) or "slam.make(" in text, f"{test} does not test {name}"


def test_every_equation_is_there():
    text = "\n".join(ROWS)
    assert all(f"eq. ({n})" in text for n in range(1, 7))
