"""The pytest plugin: a repository gates its SLAM with a marker and a fixture.

    @pytest.mark.simbench(system="my_slam.py:make", baseline="tests/smoke.json")
    def test_my_slam_is_no_worse(simbench):
        simbench.gate()

It stands outside the packages, whose imports take a second: they are loaded when a test asks.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

_MARK = ("simbench(system, suite='smoke', baseline=FILE, seeds=None, frames=None, size=None, "
         "workers=1): what the `simbench` fixture runs, and what it holds the results against")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("simbench")
    group.addoption("--simbench-bless", action="store_true",
                    help="write the baselines of simbench gates instead of comparing with them")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", _MARK)


class Gate:
    """What the fixture gives."""

    def __init__(self, options: dict[str, Any], scratch: Path, root: Path, blessing: bool) -> None:
        self._options = options
        self._scratch, self._root, self._blessing = scratch, root, blessing

    def suite(self, **options: Any) -> Path:
        """Run a suite; returns its folder, with results.json and report.html in it.

        Args:
            options: system (a name as for `simbench run --system`, or several in a list), suite
                (a name or a YAML file), seeds ("0-4"), frames, size ("320x240"), workers.
        """
        from simbench.cli.options import parse_size
        from simbench.suites.files import load_suite
        from simbench.suites.run_suite import Where, run_suite
        from simbench.suites.spec import parse_seeds

        asked = {**self._options, **options}
        system = asked.get("system")
        if system is None:
            raise pytest.UsageError("simbench: name a system, as in "
                                    "@pytest.mark.simbench(system='my_slam.py:make')")
        suite = load_suite(asked.get("suite", "smoke")).changed(
            systems=(system,) if isinstance(system, str) else tuple(system),
            seeds=None if asked.get("seeds") is None else parse_seeds(asked["seeds"]),
            frames=asked.get("frames"), size=parse_size(asked.get("size")))
        out = self._scratch / f"suite{len(list(self._scratch.iterdir()))}"
        run_suite(suite, out, Where(asked.get("workers", 1), reports="none"))
        return out

    def gate(self, **options: Any) -> None:
        """Run a suite and fail the test where it is worse than its baseline beyond noise.

        With `pytest --simbench-bless` the baseline is written instead.

        Args:
            options: as of `suite`, and baseline: a file, relative to pytest's root.
        """
        from simbench.baseline import bless, outcome_of, read_baseline
        from simbench.errors import UserError
        from simbench.gate import judge

        named = {**self._options, **options}.get("baseline")
        if named is None:
            raise pytest.UsageError("simbench: name a baseline, as in "
                                    "@pytest.mark.simbench(baseline='tests/smoke.json')")
        baseline = self._root / named
        if not self._blessing and not baseline.exists():
            pytest.fail(f"simbench: {baseline}: no such file; write it with `pytest "
                        "--simbench-bless`, on purpose, and commit it", pytrace=False)
        refused = None
        try:
            blessed = None if self._blessing else read_baseline(baseline)   # before the suite
            out = self.suite(**options)
            if blessed is None:
                bless(out, baseline)
                return
            verdict = judge(blessed, outcome_of(out))
        except UserError as error:
            refused = str(error)
        if refused is not None:     # outside the except, or pytest shows the error twice
            pytest.fail(f"simbench: {refused}", pytrace=False)
        if not verdict.passed:
            lines = [*(f"LOST: {run}" for run in verdict.lost),
                     *(f"WORSE: {change}" for change in verdict.regressions)]
            pytest.fail("simbench: worse than the baseline\n" + "\n".join(lines)
                        + f"\nreport: {out / 'report.html'}", pytrace=False)


@pytest.fixture
def simbench(request: pytest.FixtureRequest, tmp_path: Path) -> Gate:
    """Runs suites, and gates them against baselines, as the test's `simbench` marker says."""
    mark = request.node.get_closest_marker("simbench")
    return Gate({} if mark is None else dict(mark.kwargs), tmp_path, request.config.rootpath,
               request.config.getoption("--simbench-bless"))
