"""The pytest plugin: a repository gates its SLAM with a marker and a fixture.

    @pytest.mark.simbench(system="my_slam.py:make", baseline="tests/smoke.json")
    def test_my_slam_is_no_worse(simbench):
        simbench.gate()

It stands outside the packages, whose imports take a second: they are loaded when a test asks.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import pytest

T = TypeVar("T")
_OPTIONS = ("system", "suite", "baseline", "seeds", "frames", "size", "workers")
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
        return _told(lambda: self._suite(options))

    def _suite(self, options: dict[str, Any]) -> Path:
        from simbench.cli.options import parse_size
        from simbench.suites.files import load_suite
        from simbench.suites.run_suite import Where, run_suite
        from simbench.suites.spec import parse_seeds

        asked = _checked({**self._options, **options})
        system = asked["system"]
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
        worse = _told(lambda: self._gate(options))
        if worse:
            pytest.fail(worse, pytrace=False)

    def _gate(self, options: dict[str, Any]) -> str:
        """What is worse, in a line each; "" where nothing is, or the baseline was written."""
        from simbench.baseline import bless, outcome_of, read_baseline
        from simbench.errors import UserError
        from simbench.gate import judge

        named = _checked({**self._options, **options}).get("baseline")
        if not isinstance(named, (str, Path)):
            raise UserError("name a baseline, as in "
                            "@pytest.mark.simbench(baseline='tests/smoke.json')")
        baseline = self._root / named
        if self._blessing:
            bless(self._suite(options), baseline)
            return ""
        if not baseline.exists():
            raise UserError(f"{baseline}: no such file; write it with `pytest --simbench-bless`, "
                            "on purpose, and commit it")
        blessed = read_baseline(baseline)      # before the suite
        out = self._suite(options)
        verdict = judge(blessed, outcome_of(out))
        if verdict.passed:
            return ""
        return "\n".join(["simbench: worse than the baseline",
                          *(f"LOST: {run}" for run in verdict.lost),
                          *(f"WORSE: {change}" for change in verdict.regressions),
                          f"report: {out / 'report.html'}"])


def _told(work: Callable[[], T]) -> T:
    """What `work` returns; what is the user's to mend fails the test with a line."""
    from simbench.errors import UserError

    try:
        return work()
    except (UserError, OSError) as error:
        refused = str(error)
    # outside the except, or pytest shows the error twice
    pytest.fail(f"simbench: {refused}", pytrace=False)


def _checked(options: dict[str, Any]) -> dict[str, Any]:
    """The options again. Raises UserError where a name is unknown or a value of another type."""
    from simbench.errors import UserError
    from simbench.stated import MOST_FRAMES, text, whole

    for name in options:
        if name not in _OPTIONS:
            close = difflib.get_close_matches(name, _OPTIONS, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(_OPTIONS)}"
            raise UserError(f"the marker has no option {name!r}; {hint}")
    system = options.get("system")
    names = [system] if isinstance(system, str) else system
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise UserError("name a system, as in @pytest.mark.simbench(system='my_slam.py:make')")
    try:
        for name in ("frames", "workers"):
            if options.get(name) is not None:
                whole(options[name], name, 1, MOST_FRAMES)
        for name in ("suite", "size"):
            if options.get(name) is not None:
                text(options[name], name)
    except ValueError as error:
        raise UserError(str(error)) from None
    return options


@pytest.fixture
def simbench(request: pytest.FixtureRequest, tmp_path: Path) -> Gate:
    """Runs suites, and gates them against baselines, as the test's `simbench` marker says."""
    mark = request.node.get_closest_marker("simbench")
    if mark is not None and mark.args:
        pytest.fail(f"simbench: the marker's options need their names: {mark.args[0]!r} is "
                    f"which of {', '.join(_OPTIONS)}?", pytrace=False)
    return Gate({} if mark is None else dict(mark.kwargs), tmp_path, request.config.rootpath,
               request.config.getoption("--simbench-bless"))
