"""Render a scene to a sequence on disk, in one process or several, resumable to the same bytes."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from simbench import storage
from simbench.certificate import certificate, motion_sha256, origin
from simbench.errors import UserError
from simbench.processes import spawned
from simbench.render import Renderer, make_renderer
from simbench.scene import find_scene
from simbench.sensors.depth import apply_depth_noise
from simbench.sensors.rgb import apply_rgb_noise
from simbench.sensors.spec import SensorSpec, find_sensor
from simbench.sensors.streams import Stage, generator
from simbench.simulate import SimulatedSequence
from simbench.untrusted import read_json_object
from simbench.world import World, make_world
from slam.geometry.arrays import Array

_FRAMES_A_TASK = 4


@dataclass(frozen=True, slots=True)
class GenerateSettings:
    """All that decides the bytes of a sequence, besides the machine."""

    scene: str
    seed: int
    frames: int
    width: int
    height: int
    fps: float
    sensor: str
    dials: tuple[tuple[str, float], ...]
    stereo: bool = False

    @classmethod
    def resolve(cls, scene: str, *, seed: int = 0, frames: int | None = None,
                size: tuple[int, int] | None = None, fps: float | None = None,
                sensor: str = "ideal", dials: Mapping[str, float | str] | None = None,
                stereo: bool = False) -> GenerateSettings:
        """Settings with the scene's own values where none are given.

        Raises:
            UserError: an unknown scene, sensor or dial, a value out of range, or stereo together
                with motion blur.
        """
        spec = find_scene(scene)
        model = find_sensor(sensor)
        if stereo and model.exposure_s > 0:
            raise UserError(f"--stereo with --sensor {sensor}: motion blur is not rendered for "
                            "right images; choose a sensor without exposure")
        width, height = size or (spec.width, spec.height)
        frames = spec.frames if frames is None else frames
        fps = float(spec.fps if fps is None else fps)
        spec.check_view((width, height), fps, frames)
        return cls(scene, seed, frames, width, height, fps, sensor,
                   tuple(sorted(spec.resolve_dials(dials).items())), stereo)

    def make_world(self) -> World:
        """The world at time 0. Raises UserError when a value is out of range."""
        return make_world(self.scene, self.seed, dict(self.dials), (self.width, self.height),
                          self.fps)

    def as_json(self) -> dict[str, Any]:
        """The settings as sequence.json holds them."""
        return {"scene": self.scene, "seed": self.seed, "frames": self.frames,
                "size": [self.width, self.height], "fps": self.fps, "sensor": self.sensor,
                "dials": dict(self.dials), "stereo": self.stereo}


def generate(settings: GenerateSettings, out: Path, *, workers: int = 1, resume: bool = False,
             on_frame: Callable[[], None] = lambda: None) -> int:
    """Write the sequence to `out`; equal settings give equal bytes, however many the workers.

    Args:
        workers: processes that render, each disjoint frames; 1 renders in this process.
        resume: keep the frames that a killed run with the same settings has written.
        on_frame: is called once for each frame that is there.
    Returns:
        How many frames were rendered now.
    Raises:
        UserError: the folder holds something else, or was made with other settings or versions.
        OSError: the disk is full or the folder cannot be written.
    """
    world = settings.make_world()   # wrong values show before anything is written
    identity = identity_of(settings, world)
    if _claim(out, identity, resume):
        for _ in range(settings.frames):
            on_frame()
        return 0
    studio = _Studio.build(settings)
    try:
        target = _write_fixed(out, studio.sequence, settings)
        missing = [k for k in range(settings.frames)
                   if not storage.frame_is_there(out, k, settings.stereo)]
        for _ in range(settings.frames - len(missing)):
            on_frame()
        if workers > 1 and len(missing) > 1:
            _render_in_workers(settings, target, missing, workers, on_frame)
        else:
            for k in missing:
                _write_frame(studio, target, k)
                on_frame()
    finally:
        studio.renderer.close()
    objects = [{"instance_id": o.instance_id, "name": o.name, "root_part": o.root_part,
                "rigid": o.rigid, "category": o.category} for o in world.layout.objects]
    manifest = {**identity, "motion_sha256": target.motion_sha256,
                "depth_scale": target.depth_scale, "objects": objects,
                "files": storage.file_hashes(out)}
    storage.write_json(out / storage.MANIFEST, {**manifest, "certificate": certificate(manifest)})
    (out / storage.UNFINISHED).unlink()
    return len(missing)


@dataclass(frozen=True, slots=True)
class _Target:
    """Where frames go and how they are encoded."""

    out: Path
    depth_scale: float
    baseline_m: float | None
    motion_sha256: str


@dataclass(frozen=True, slots=True)
class _Studio:
    """A scene with all its instants, and what draws it."""

    settings: GenerateSettings
    sequence: SimulatedSequence
    renderer: Renderer

    @classmethod
    def build(cls, settings: GenerateSettings) -> _Studio:
        world = settings.make_world()
        renderer = make_renderer("mujoco", world)
        return cls(settings, SimulatedSequence(world, renderer, settings.frames,
                                               stereo=settings.stereo), renderer)

    def left(self, k: int, sensor: SensorSpec) -> Array:
        """(H, W, 3) uint8 before noise."""
        if sensor.exposure_s > 0:
            return self.sequence.render_blurred(k, sensor.exposure_s,
                                                sensor.exposure_subframes)
        return self.sequence.rgb(k)


def identity_of(settings: GenerateSettings, world: World) -> dict[str, Any]:
    """All that decides the bytes of a sequence but its motion, as sequence.json holds it."""
    return {"schema": storage.SCHEMA, **settings.as_json(), **origin(world, settings.sensor)}


def _claim(out: Path, identity: dict[str, Any], resume: bool) -> bool:
    """Make `out` ours; True when the sequence is there already. Raises UserError."""
    unfinished, manifest = out / storage.UNFINISHED, out / storage.MANIFEST
    out.mkdir(parents=True, exist_ok=True)
    if not any(out.iterdir()):
        storage.write_json(unfinished, identity)
        return False
    if not resume:
        raise UserError(f"{out}: the folder is not empty; choose another --out, or give --resume "
                        "to finish a sequence that was begun there")
    begun = manifest if manifest.exists() else unfinished
    if not begun.exists():
        raise UserError(f"{out}: no sequence was begun here, so there is nothing to resume; "
                        "choose another --out")
    before = read_json_object(begun, "choose another --out")
    changed = [key for key, value in identity.items() if before.get(key) != value]
    if changed:
        key = changed[0]
        raise UserError(f"{out}: was begun with {key} {before.get(key)!r}, now it is "
                        f"{identity[key]!r}; give the same or choose another --out")
    storage.remove_temporaries(out)
    return begun == manifest


def _write_fixed(out: Path, sequence: SimulatedSequence,
                 settings: GenerateSettings) -> _Target:
    """Write what needs no rendering, and choose the scale of depth and the stereo baseline."""
    worlds = (sequence.truth.world_at(k) for k in range(len(sequence)))
    cameras, parts, states = zip(*((w.T_world_camera, w.T_world_part, w.state()) for w in worlds),
                                 strict=True)
    T_world_camera, T_world_part = np.stack(cameras), np.stack(parts)
    layout = sequence.truth.layout
    scale = storage.depth_scale_for(sequence.truth.reach_m)
    baseline_m = sequence.intrinsics.baseline_m
    for kind in (*storage.PICTURES, *(("right",) if settings.stereo else ())):
        (out / kind).mkdir(exist_ok=True)
    storage.write_fixed_truth(out, layout, sequence.stamps_s, T_world_camera, T_world_part,
                              np.stack(states))
    storage.write_calibration(out, sequence.intrinsics, scale, baseline_m)
    storage.write_lists(out, sequence.stamps_s, T_world_camera)
    return _Target(out, scale, baseline_m, motion_sha256(T_world_camera, T_world_part))


def _write_frame(studio: _Studio, target: _Target, k: int) -> None:
    """Render frame k, pass it through the sensor and write its files."""
    sequence, out, seed = studio.sequence, target.out, studio.settings.seed
    sensor = find_sensor(studio.settings.sensor)
    truth = sequence.truth.frame(k)
    depth_m = apply_depth_noise(truth.depth_m, sequence.intrinsics, sensor.depth,
                                generator(seed, Stage.DEPTH, k))
    storage.write_frame_truth(out, truth, sequence.truth.layout)
    storage.write_png(storage.image_path(out, "depth", k),
                      storage.encode_depth(depth_m, target.depth_scale))
    storage.write_png(storage.image_path(out, "instance", k), truth.instance_id.astype(np.uint16))
    left = apply_rgb_noise(studio.left(k, sensor), sensor.rgb, generator(seed, Stage.RGB, k))
    storage.write_png(storage.image_path(out, "rgb", k), left)
    if target.baseline_m is not None:
        right = apply_rgb_noise(sequence.right(k), sensor.rgb,
                                generator(seed, Stage.RGB_RIGHT, k))
        storage.write_png(storage.image_path(out, "right", k), right)


def _render_in_workers(settings: GenerateSettings, target: _Target, missing: list[int],
                       workers: int, on_frame: Callable[[], None]) -> None:
    """Render in spawned processes, each with its share of the processors."""
    threads = max(1, (os.cpu_count() or 1) // workers)
    tasks = [missing[i:i + _FRAMES_A_TASK] for i in range(0, len(missing), _FRAMES_A_TASK)]
    try:
        with spawned(workers) as pool:
            for done in as_completed([pool.submit(_render_task, settings, target, task, threads)
                                      for task in tasks]):
                for _ in range(done.result()):
                    on_frame()
    except BrokenProcessPool:
        raise UserError(f"{target.out}: a rendering process died: out of memory (give fewer "
                        "--workers and --resume), or a script without `if __name__ == "
                        "'__main__'`") from None


def _render_task(settings: GenerateSettings, target: _Target, frames: list[int],
                 threads: int) -> int:
    studio = _studio_of_this_process(settings, threads)
    for k in frames:
        _write_frame(studio, target, k)
    return len(frames)


@lru_cache(maxsize=1)
def _studio_of_this_process(settings: GenerateSettings, threads: int) -> _Studio:
    """A worker's own world and renderer, made when its first task comes and kept to its end."""
    os.environ["LP_NUM_THREADS"] = str(threads)   # Mesa's software rasteriser takes all otherwise
    return _Studio.build(settings)
