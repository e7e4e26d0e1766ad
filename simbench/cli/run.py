"""`simbench run`: a system over a scene or a folder, scored."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from simbench.cli.options import (
    Calibration,
    DialValues,
    Fps,
    MemoryLimit,
    Rigidity,
    Seed,
    Size,
    Texture,
    TimeLimit,
    TrustedScene,
    collect_dials,
    parse_size,
    trust_scene,
)
from simbench.errors import UnknownName, UserError

if TYPE_CHECKING:
    from simbench.outcome import Outcome
    from simbench.program import Limits
    from simbench.sequence import Sequence


def run_command(
        source: Annotated[str, typer.Argument(
            metavar="SCENE_OR_DIR", help="A scene by name, or the folder of a sequence.")],
        system: Annotated[str, typer.Option(
            "--system", metavar="NAME",
            help="As `simbench list` names it, package.module:factory, file.py:factory or "
                 "command:\"program {sequence} {out}\".")],
        out: Annotated[Path, typer.Option("--out", metavar="RUN", help="Folder to write.")],
        flow: Annotated[str | None, typer.Option(
            "--flow", help="truth, noisy, dis or given; what the source holds by default.")] = None,
        masks: Annotated[str | None, typer.Option(
            "--masks", help="truth, noisy, given, hsv or none.")] = None,
        boxes: Annotated[str | None, typer.Option(
            "--boxes", help="truth, noisy, detector, given or none.")] = None,
        detector: Annotated[Path | None, typer.Option(
            "--detector", metavar="FILE.onnx",
            help="Weights of a COCO detector, which finds the boxes in the images.")] = None,
        depth: Annotated[str | None, typer.Option(
            "--depth", help="truth, sensor, stereo or given.")] = None,
        flow_sigma: Annotated[float | None, typer.Option(
            "--flow-sigma", min=0.0, metavar="PX",
            help="Standard deviation of --flow noisy; the sensor's by default.")] = None,
        flow_noise: Annotated[str | None, typer.Option(
            "--flow-noise", help="pairwise or localisation: how the noise adds up along tracks."
        )] = None,
        flow_shape: Annotated[str | None, typer.Option(
            "--flow-shape", help="isotropic, or structure: as the image's texture allows.")] = None,
        calibration: Calibration = None, seed: Seed = 0,
        frames: Annotated[int | None, typer.Option(
            "--frames", min=1, help="Only so many frames; all by default.")] = None,
        size: Size = None, fps: Fps = None,
        sensor: Annotated[str | None, typer.Option(
            "--sensor", help="Sensor model; `simbench list` shows all. Folders hold their own."
        )] = None,
        texture: Texture = None, rigidity: Rigidity = None, dial: DialValues = None,
        settings: Annotated[list[str] | None, typer.Option(
            "--set", metavar="STAGE.FIELD=VALUE",
            help="A setting of the system; may be given several times.")] = None,
        time_limit: TimeLimit = None, memory_limit: MemoryLimit = None,
        scene: TrustedScene = None) -> None:
    """Run a system and score it against the truth."""
    from simbench.captured_log import captured_log
    from simbench.cli.progress import frame_progress
    from simbench.inputs import Feed, InputChoice
    from simbench.program import PREFIX, Limits
    from simbench.run_to_folder import run_to_folder

    trust_scene(scene)
    dials = collect_dials(dial, texture, rigidity)
    if system.startswith(PREFIX):
        not_ours = {"--flow": flow, "--masks": masks, "--boxes": boxes, "--depth": depth,
                    "--detector": detector,
                    "--set": settings, "--flow-sigma": flow_sigma, "--flow-noise": flow_noise,
                    "--flow-shape": flow_shape}
        for option, value in not_ours.items():
            if value is not None:
                raise UserError(f"{option}: {system} reads the sequence's folder itself; "
                                f"leave {option} out")
        outcome = _run_program(system, source, calibration, out, {
            "seed": seed, "frames": frames, "size": parse_size(size), "fps": fps,
            "sensor": sensor or "ideal", "dials": dials},
            Limits(time_limit, memory_limit))
        _tell(system, outcome, out)
        return
    if time_limit is not None or memory_limit is not None:
        raise UserError(f"--{'time' if time_limit is not None else 'memory'}-limit: {system} runs "
                        "inside simbench; limits are for command:\"program …\"")
    choice = InputChoice(flow=flow, masks=masks, boxes=boxes, depth=depth, sensor=sensor,
                         detector=None if detector is None else str(detector),
                         flow_sigma_px=flow_sigma, flow_noise_kind=flow_noise,
                         flow_noise_shape=flow_shape)
    scene_options = {"size": parse_size(size), "fps": fps, "dials": dials}
    only_scenes = [option for option, value in (
        ("--size", size), ("--fps", fps), ("--texture", texture), ("--rigidity", rigidity),
        ("--dial", dial), ("--sensor", sensor)) if value is not None]
    with captured_log() as said, _opened(source, calibration, seed, frames,
                                         scene_options, only_scenes, depth == "stereo") as sequence:
        feed = Feed(sequence, choice, seed, frames)
        with frame_progress(f"{system} on {sequence.name}", len(feed)) as advance:
            outcome = run_to_folder(
                system, feed, out, settings=settings or (), log=tuple(said),
                command={"source": source} | {k: v for k, v in scene_options.items() if v},
                progress=lambda _done: advance())
    _tell(system, outcome, out)


def _tell(system: str, outcome: Outcome, out: Path) -> None:
    """Print the tables. Exit code 1 where the system lost the whole run."""
    from simbench.cli.error_table import print_outcome

    print_outcome(outcome, out)
    if outcome.failure:
        reason = " ".join(outcome.failure.split())
        typer.echo(f"error: {system} {reason}; see {out / 'log.txt'}", err=True)
        raise typer.Exit(1)


@contextmanager
def _opened(source: str, calibration: str | None, seed: int, frames: int | None,
            scene_options: dict[str, Any], only_scenes: list[str], stereo: bool
            ) -> Iterator[Sequence]:
    """A folder as it is, or a scene rendered as it is asked for."""
    if Path(source).exists() or _looks_like_a_path(source):
        from simbench.sequence import open_sequence
        if only_scenes:
            raise UserError(f"{source}: {only_scenes[0]} is for scenes; a folder is as it was "
                            "recorded, leave it out")
        yield open_sequence(source, calibration)
        return
    _check_scene(source)
    from simbench.render import make_renderer
    from simbench.simulate import SimulatedSequence
    from simbench.world import make_world

    if calibration is not None:
        raise UserError(f"--calibration {calibration}: {source} is a scene and knows its camera")
    world = make_world(source, seed, scene_options["dials"], scene_options["size"],
                       scene_options["fps"])
    renderer = make_renderer("mujoco", world)
    try:
        yield SimulatedSequence(world, renderer, world.spec.frames if frames is None else frames,
                                stereo=stereo)
    finally:
        renderer.close()


def _run_program(system: str, source: str, calibration: str | None, out: Path,
                 scene_settings: dict[str, Any], limits: Limits) -> Outcome:
    """A program reads a folder; a scene is rendered into RUN/sequence first."""
    from simbench import run_folder
    from simbench.program import run_program, words_of
    from simbench.remote import local_folder
    from simbench.sequence import open_sequence

    words_of(system)   # wrong words show before a scene is rendered for them
    folder = local_folder(source)
    if not (folder.exists() or _looks_like_a_path(source)):
        from simbench.cli.progress import frame_progress
        from simbench.generate import GenerateSettings, generate

        _check_scene(source)
        rendering = GenerateSettings.resolve(source, **scene_settings)
        folder = out / "sequence"
        run_folder.prepare(out)   # a place for no run shows before a scene is rendered into it
        with frame_progress(rendering.scene, rendering.frames) as advance:
            generate(rendering, folder, resume=True, on_frame=advance)
    else:
        asked = next((k for k, v in scene_settings.items()
                      if k != "seed" and v not in (None, {}, "ideal")), None)
        if asked is not None:
            raise UserError(f"{source}: --{asked.rstrip('s') if asked == 'dials' else asked} is "
                            "for scenes here; the program reads the folder as it is")
    return run_program(system, open_sequence(folder, calibration), folder, out, limits)


def _check_scene(source: str) -> None:
    """Raises UnknownName where there is no such scene, and no such folder either."""
    from simbench.scene import find_scene
    try:
        find_scene(source)
    except UnknownName as error:
        raise UnknownName(f"{error}; or give the path of a folder") from None


def _looks_like_a_path(source: str) -> bool:
    return "://" in source or (":" not in source and ("/" in source or source.startswith(".")))
