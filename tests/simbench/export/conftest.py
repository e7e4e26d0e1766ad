"""The room of known motion, small, as exporters are given it."""

import pytest

from simbench.render import make_renderer
from simbench.simulate import SimulatedSequence
from simbench.world import make_world


@pytest.fixture(scope="package")
def marker_sequence(marker_spec):
    world = make_world(marker_spec, size=(160, 120))
    renderer = make_renderer("mujoco", world)
    yield SimulatedSequence(world, renderer, frames=6, stereo=True)
    renderer.close()
