"""sequence.json: every value of it checked before anything relies on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simbench.errors import BadFile
from simbench.storage import MANIFEST, SCHEMA
from simbench.types import ObjectInfo
from simbench.untrusted import MOST_SIDE_PX, read_json_object

if TYPE_CHECKING:      # needs MuJoCo; frames and poses do not
    from simbench.world import World

_AGAIN = "generate the sequence again"
_MOST_FRAMES = 1_000_000
_MOST_BYTES = 200_000_000
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
    width, height = _list(said["size"], "size")
    return Manifest(
        said, _text(said["scene"], "scene"), _whole(said["seed"], "seed", 0, 2**63),
        _whole(said["frames"], "frames", 1, _MOST_FRAMES),
        (_whole(width, "size", 8, MOST_SIDE_PX), _whole(height, "size", 8, MOST_SIDE_PX)),
        _number(said["fps"], "fps"), _text(said["sensor"], "sensor"),
        {name: _number(value, f"dial {name:.40}") for name, value in
         _mapping(said["dials"], "dials").items()},
        bool(said["stereo"]),
        tuple(_object(each) for each in _list(said["objects"], "objects")),
        {name: _text(value, "files") for name, value in _mapping(said["files"], "files").items()})


def _object(said: Any) -> ObjectInfo:
    values = _mapping(said, "an object")
    return ObjectInfo(_whole(values["instance_id"], "instance_id", 1, _MOST_ID),
                      _text(values["name"], "name"), _whole(values["root_part"], "root_part", 0,
                                                            _MOST_ID),
                      bool(values["rigid"]), _text(values.get("category", ""), "category"))


def _whole(value: Any, key: str, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{key} is {value!r:.40}, wanted a whole number from {low} to {high}")
    return value


def _number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) \
            or not math.isfinite(value) or abs(value) > 1e9:
        raise ValueError(f"{key} is {value!r:.40}, wanted a number")
    return value


def _text(value: Any, key: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{key} is {value!r:.40}, wanted a text")
    return value


def _list(value: Any, key: str) -> list[Any]:
    if not isinstance(value, list) or (key == "size" and len(value) != 2):
        raise ValueError(f"{key} is {value!r:.40}, wanted a list")
    return value


def _mapping(value: Any, key: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{key} is {value!r:.40}, wanted a mapping")
    return value
