"""The scene that a run was made on, as its folder names it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simbench.errors import BadFile
from simbench.scene import SceneSpec, known_scene
from simbench.untrusted import read_yaml
from simbench.world import World, make_world

_SCENE = re.compile(r"[A-Za-z]\w*-v\d+|.+:[A-Za-z]\w*-v\d+")


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
        if not _SCENE.fullmatch(name):
            return None
        return RunSource(known_scene(name), int(config.get("seed", 0)), int(config["frames"]),
                         None if size is None else (int(size[0]), int(size[1])),
                         None if fps is None else float(fps), dict(config.get("dials") or {}))
    except (KeyError, TypeError, AttributeError, ValueError, IndexError) as error:
        raise BadFile(f"{path}: not of a run of this version ({type(error).__name__}); run it again"
                      ) from None
