"""A small room of known motion, for tests of pixels and truth; suites without processes."""

import runpy
from contextlib import contextmanager
from pathlib import Path

import pytest

from here import Here
from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.suites import run_suite
from simbench.suites.pool import Workers
from simbench.world import make_world


@pytest.fixture(scope="session")
def marker_spec():
    return runpy.run_path(str(Path(__file__).parent / "scenes" / "marker_room.py"))["SPEC"]


@pytest.fixture
def marker_world(marker_spec):
    return make_world(marker_spec)


@pytest.fixture(scope="session")
def marker_sequence(marker_spec):
    world = make_world(marker_spec)
    renderer = make_renderer("mujoco", world)
    yield SimulatedSequence(world, renderer, frames=12)
    renderer.close()


@pytest.fixture
def in_this_process(monkeypatch):
    """`simbench suite` does its tasks here."""
    @contextmanager
    def workers(count):
        yield Workers(Here(), 1)

    monkeypatch.setattr(run_suite, "local_workers", workers)
