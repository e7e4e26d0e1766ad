"""Suites without processes, for tests of what does not depend on them."""

from contextlib import contextmanager

import pytest

from here import Here
from simbench.suites import run_suite
from simbench.suites.pool import Workers


@pytest.fixture
def in_this_process(monkeypatch):
    """`simbench suite` does its tasks here."""
    @contextmanager
    def workers(count):
        yield Workers(Here(), 1)

    monkeypatch.setattr(run_suite, "local_workers", workers)
