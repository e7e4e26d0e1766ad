"""sequence.json: every value of it checked before anything relies on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simbench.errors import BadFile
from simbench.stated import MOST_FRAMES, MOST_SEED, items, mapping, number, text, whole
from simbench.storage import MANIFEST, SCHEMA
from simbench.types import ObjectInfo
from simbench.untrusted import MOST_SIDE_PX, read_json_object

if TYPE_CHECKING:      # needs MuJoCo; frames and poses do not
    from simbench.world import World

_AGAIN = "generate the sequence again"
_MOST_BYTES = 200_000_000
_FARTHEST = 1e9
_MOST_ID = 65535        # masks are 16-bit images


@dataclass(frozen=True, slots=True)
class Manifest:
    """How a sequence was made. `said` is all of it, as it stands in the file."""

    said: Mapping[str, Any]
    scene: str
    seed: int
    frames: int
    size: tuple[int, int]
    fps: float
    sensor: str
    dials: Mapping[str, float]
    stereo: bool
    objects: tuple[ObjectInfo, ...]
    files: Mapping[str, str]

    def make_world(self) -> World:
        """The scene, built again.

        Raises:
            UserError: a scene of the user's own that is not loaded, or a value out of range.
        """
        from simbench.scene import known_scene  # noqa: PLC0415 (see TYPE_CHECKING above)
        from simbench.world import make_world  # noqa: PLC0415
        return make_world(known_scene(self.scene), self.seed, self.dials, self.size, self.fps)


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a generated sequence. Raises BadFile; the message says what is wrong."""
    path = folder / MANIFEST
    said = read_json_object(path, _AGAIN, _MOST_BYTES)
    if said.get("schema") != SCHEMA:
        raise BadFile(f"{path}: schema is {said.get('schema')!r:.40}, wanted {SCHEMA}; {_AGAIN}")
    try:
        return _manifest(said)
    except KeyError as error:
        raise BadFile(f"{path}: key {error.args[0]!r} is missing; {_AGAIN}") from None
    except (ValueError, TypeError) as error:
        raise BadFile(f"{path}: {error}; {_AGAIN}") from None


def _manifest(said: Mapping[str, Any]) -> Manifest:
    width, height = items(said["size"], "size", 2)
    return Manifest(
        said, text(said["scene"], "scene"), whole(said["seed"], "seed", 0, MOST_SEED),
        whole(said["frames"], "frames", 1, MOST_FRAMES),
        (whole(width, "size", 8, MOST_SIDE_PX), whole(height, "size", 8, MOST_SIDE_PX)),
        number(said["fps"], "fps", _FARTHEST), text(said["sensor"], "sensor"),
        {name: number(value, f"dial {name:.40}", _FARTHEST) for name, value in
         mapping(said["dials"], "dials").items()},
        bool(said["stereo"]),
        tuple(_object(each) for each in items(said["objects"], "objects")),
        {name: text(value, "files") for name, value in mapping(said["files"], "files").items()})


def _object(said: Any) -> ObjectInfo:
    values = mapping(said, "an object")
    return ObjectInfo(whole(values["instance_id"], "instance_id", 1, _MOST_ID),
                      text(values["name"], "name"),
                      whole(values["root_part"], "root_part", 0, _MOST_ID),
                      bool(values["rigid"]), text(values.get("category", ""), "category"))
