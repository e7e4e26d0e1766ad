"""The scene that a run was made on, as its folder names it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simbench.errors import BadFile
from simbench.scene import SceneSpec, is_scene_name, known_scene
from simbench.stated import MOST_FRAMES, MOST_SEED, items, mapping, number, whole
from simbench.untrusted import MOST_SIDE_PX, read_yaml
from simbench.world import World, make_world

_FASTEST_HZ = 1e9


@dataclass(frozen=True, slots=True)
class RunSource:
    """A scene and what was asked of it."""

    scene: SceneSpec
    seed: int
    frames: int
    size: tuple[int, int] | None
    fps: float | None
    dials: Mapping[str, float | str]

    def make_world(self) -> World:
        """The scene as the run saw it. Raises UserError when a value is out of range."""
        return make_world(self.scene, self.seed, self.dials, self.size, self.fps)


def read_source(folder: Path) -> RunSource | None:
    """The scene of a run's folder; None where it was made on a recording.

    Raises:
        BadFile: config.yaml is missing or broken.
        UserError: the scene is one that the user has not loaded.
    """
    path = folder / "config.yaml"
    try:
        config = read_yaml(path, "run it again")
        name, size, fps = str(config["source"]), config.get("size"), config.get("fps")
        if not is_scene_name(name):
            return None
        width, height = (None, None) if size is None else items(size, "size", 2)
        return RunSource(
            known_scene(name), whole(config.get("seed", 0), "seed", 0, MOST_SEED),
            whole(config["frames"], "frames", 1, MOST_FRAMES),
            None if size is None else (whole(width, "size", 1, MOST_SIDE_PX),
                                       whole(height, "size", 1, MOST_SIDE_PX)),
            None if fps is None else number(fps, "fps", _FASTEST_HZ),
            mapping(config.get("dials") or {}, "dials"))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise BadFile(f"{path}: not of a run of this version ({type(error).__name__}); run it again"
                      ) from None
