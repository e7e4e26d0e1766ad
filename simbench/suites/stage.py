"""The frames of a run: a scene rendered in memory, a sequence on disk, or a folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from simbench.generate import GenerateSettings
from simbench.render import make_renderer
from simbench.sequence import Sequence, open_sequence
from simbench.simulate import SimulatedSequence
from simbench.suites.cache import SequenceCache
from simbench.suites.spec import SequenceSpec
from simbench.world import make_world

_MEMORY_BYTES = 1_000_000_000        # of frames kept for the next run of a task
_BYTES_A_PIXEL = 40                  # picture, depth, parts, objects, flow and scene flow


@contextmanager
def opened(spec: SequenceSpec, runs: int, cache: SequenceCache | None,
           blurred: bool) -> Iterator[Sequence]:
    """The sequence of a task.

    Args:
        runs: how many are to see it; of several, the frames are kept in memory if they fit.
        cache: where rendered sequences are looked for first, and kept; None renders in memory.
        blurred: some run wants motion blur, which a sequence on disk cannot show.
    Raises:
        UserError: an unknown scene, a value out of range, or a folder that is no sequence.
    """
    if spec.folder:
        yield open_sequence(spec.folder, spec.calibration or None)
    elif cache is not None and not blurred:
        with cache.folder_of(generate_settings(spec, "ideal")) as folder:
            yield open_sequence(folder)
    else:
        with rendered(spec, runs) as sequence:
            yield sequence


@contextmanager
def rendered(spec: SequenceSpec, runs: int = 1) -> Iterator[SimulatedSequence]:
    """A scene as it is drawn, frame by frame."""
    world = make_world(spec.scene, spec.seed, dict(spec.dials), spec.size, spec.fps)
    renderer = make_renderer("mujoco", world)
    frames = spec.frames or world.spec.frames
    camera = world.layout.intrinsics
    fit = runs > 1 and frames * _BYTES_A_PIXEL * camera.width * camera.height <= _MEMORY_BYTES
    try:
        yield (SimulatedSequence(world, renderer, frames, frames, stereo=spec.stereo) if fit
               else SimulatedSequence(world, renderer, frames, stereo=spec.stereo))
    finally:
        renderer.close()


def generate_settings(spec: SequenceSpec, sensor: str) -> GenerateSettings:
    """What renders this sequence to disk. Raises UserError on a wrong value."""
    return GenerateSettings.resolve(spec.scene, seed=spec.seed, frames=spec.frames,
                                    size=spec.size, fps=spec.fps, sensor=sensor,
                                    dials=dict(spec.dials), stereo=spec.stereo)

