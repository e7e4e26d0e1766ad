"""Scenes by name and version: what there is to render, and how it moves with time and seed.

The short way to a scene of your own is one MJCF file and one function of time:

    def motion(time_s, seed, dials):
        return {"camera": look_at((-3, 0, 1.5), (0, 0, 1)), "crate": pose((0, np.sin(time_s), 1))}

    simbench.register_scene(name="Crate-v0", description="a crate", mjcf="crate.xml", motion=motion)

The long way is a `build` function that edits the MjSpec from a seed and returns a `Staging`.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.resources
import importlib.util
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
from numpy.typing import ArrayLike

from simbench.envs import register_env
from simbench.errors import BadFile, UnknownName, UserError
from simbench.stated import MOST_FRAMES
from simbench.untrusted import MOST_SIDE_PX

Dials = Mapping[str, float]
# The name of a body (or "camera") to its pose T_world_body (4, 4) (the camera in OpenCV axes),
# the name of a hinge or slide joint to its position (rad or m).
Placement = Mapping[str, ArrayLike]
Script = Callable[[float], Placement]                  # time in s
Motion = Callable[[float, int, Dials], Placement]      # time in s, seed, dials

_NAME = re.compile(r"[A-Za-z]\w*-v\d+")


@dataclass(frozen=True, slots=True)
class Dial:
    """One number that makes a scene easier or harder."""

    name: str
    default: float
    low: float
    high: float
    help: str
    integer: bool = False   # a count: fractions are refused
    choices: tuple[str, ...] = ()   # names of the values 0, 1, ...; either may be given

    def shown(self, value: float) -> str:
        """The value as a user gives it."""
        return self.choices[int(value)] if self.choices else f"{value:g}"

    def number(self, given: float | str) -> float:
        """What a user gave as a number; NaN where it is none."""
        if given in self.choices:
            return float(self.choices.index(str(given)))
        try:
            return float(given)
        except (TypeError, ValueError):
            return math.nan

    @property
    def allowed(self) -> str:
        """What may be given, in words."""
        return ", ".join(self.choices) if self.choices else f"{self.low:g} to {self.high:g}"


def choice_dial(name: str, choices: tuple[str, ...], help: str) -> Dial:
    """A dial of named values; the first is the default."""
    return Dial(name, 0.0, 0.0, float(len(choices) - 1), help, True, choices)


# Every scene has these two: they act on whatever textures and lights the model holds.
TEXTURE = Dial("texture", 1.0, 0.0, 1.0, "contrast of all textures; 0 leaves plain colours")
LIGHT = Dial("light", 1.0, 0.1, 2.0, "brightness of all lights")


@dataclass(frozen=True, slots=True)
class SceneObject:
    """A body that, with everything below it, has a mask and an instance id of its own."""

    body: str
    rigid: bool | None = None   # None: rigid unless bodies below it have joints
    category: str = ""          # as COCO names it ("person", "car"); else no detector knows it


@dataclass(frozen=True, slots=True)
class Staging:
    """What a `build` function returns: the scripted part of the motion, and who is an object."""

    script: Script
    objects: tuple[SceneObject, ...] | None = None   # None: each moving child of the world
    shortest_edge_m: float = 0.1          # shorter ones are no use as segments
    edgeless: tuple[str, ...] = ()        # materials whose facets are no edges, such as leaves


Build = Callable[[mujoco.MjSpec, int, Dials], Staging]


@dataclass(frozen=True, slots=True)
class SceneSpec:
    """One version of one scene.

    Either `motion` (the short way) or `build` (the long way) is given. Bodies with joints that
    nothing scripts are left to physics.
    """

    name: str                   # ends in -v0, -v1, ...: a change of what is seen is a new version
    description: str
    mjcf: str | Path
    motion: Motion | None = None
    build: Build | None = None
    objects: tuple[str | SceneObject, ...] | None = None
    dials: tuple[Dial, ...] = field(default=())
    width: int = 640
    height: int = 480
    fps: float = 30.0
    frames: int = 300
    most_objects: int = 16      # environments pad their truth to so many

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise UserError(f"scene name {self.name!r}: it must end in a version, as in 'Room-v0'")
        if (self.motion is None) == (self.build is None):
            raise UserError(f"scene {self.name}: give either motion=... or build=..., not both")
        own = [d for d in (TEXTURE, LIGHT) if d.name not in {dial.name for dial in self.dials}]
        object.__setattr__(self, "dials", (*self.dials, *own))

    def check_view(self, size: tuple[int, int], fps: float, frames: int = 1) -> None:
        """Raises UserError where nothing is drawn of that size (width, height) px, rate or length.
        """
        width, height = size
        if min(size) < 8 or max(size) > MOST_SIDE_PX:
            raise UserError(f"scene {self.name}: size {width}x{height} must be from 8 to "
                            f"{MOST_SIDE_PX} pixels")
        if not 0.1 <= fps <= 1000.0:
            raise UserError(f"scene {self.name}: fps {fps:g} must be from 0.1 to 1000")
        if not 1 <= frames <= MOST_FRAMES:
            raise UserError(f"scene {self.name}: {frames} frames; wanted 1 to {MOST_FRAMES}")

    def resolve_dials(self, given: Mapping[str, float | str] | None = None) -> dict[str, float]:
        """All dials with their values: those given, else the defaults.

        Raises:
            UnknownName: a dial that this scene does not have.
            UserError: a value that is no number or out of range.
        """
        values = {dial.name: dial.default for dial in self.dials}
        for name, value in (given or {}).items():
            if name not in values:
                raise UnknownName(f"scene {self.name} has no dial {name!r}"
                                  f"{_did_you_mean(name, values)}it has {', '.join(values)}")
            dial = next(dial for dial in self.dials if dial.name == name)
            number = dial.number(value)
            in_range = dial.low <= number <= dial.high
            whole = number.is_integer() or not dial.integer
            given_as = value if isinstance(value, str) else f"{value:g}"
            what = f"scene {self.name}: dial {name}={given_as}"
            if dial.choices and not (in_range and whole):
                raise UnknownName(f"{what} must be one of {dial.allowed}")
            if not in_range:
                raise UserError(f"{what} must be a number from {dial.allowed}")
            if not whole:
                raise UserError(f"{what} must be a whole number")
            values[name] = number
        return values


_SCENES: dict[str, SceneSpec] = {}


def register_scene(spec: SceneSpec | None = None, /, **fields: Any) -> SceneSpec:
    """Make a scene known by its name; either a SceneSpec or its fields as keywords.

    The same function registers its scene anew where a notebook's cell or a file is run again.
    Raises:
        UserError: the fields do not make a scene, or the name is taken by another scene.
    """
    if spec is None:
        try:
            spec = SceneSpec(**fields)
        except TypeError as error:
            raise UserError(f"register_scene: {error}".replace("SceneSpec.__init__() ", "")) \
                from None
    known = _SCENES.get(spec.name)
    if known is not None and known != spec and _home(known) != _home(spec):
        raise UserError(f"scene {spec.name} is registered already; give yours another name "
                        "or a higher version")
    _SCENES[spec.name] = spec
    register_env(spec.name)
    return spec


def _home(spec: SceneSpec) -> tuple[str, str]:
    """The module and the name of the function that a scene is made by."""
    function = spec.build if spec.motion is None else spec.motion
    return getattr(function, "__module__", ""), getattr(function, "__qualname__", repr(function))


def find_scene(name: str) -> SceneSpec:
    """The scene of that name.

    `package.module:Name-v0` and `path/to/file.py:Name-v0` first import the module or run the file
    that registers it.

    Raises:
        UnknownName: no such scene; the message has the nearest name.
        BadFile: the module or file before the colon cannot be imported.
    """
    _load_builtin()
    place, colon, short = name.rpartition(":")
    if colon and short not in _SCENES:
        _import_place(place)
    if short not in _SCENES:
        raise UnknownName(f"no scene {short!r}{_did_you_mean(short, _SCENES)}"
                          f"`simbench list` shows all {len(_SCENES)}")
    return _SCENES[short]


def is_scene_name(name: str) -> bool:
    """Whether it names a scene, perhaps with its file or module before a colon."""
    place, colon, short = name.rpartition(":")
    return bool(_NAME.fullmatch(short)) and (bool(place) or not colon)


def known_scene(name: str) -> SceneSpec:
    """The scene of that name as a file names it, which may come from a stranger: nothing is run.

    Raises:
        UserError: it is neither built in nor loaded by the user before.
    """
    _load_builtin()
    short = name.rpartition(":")[2]
    if short not in _SCENES:
        raise UserError(f"scene {name}: is not run because a file names it; if you trust it, give "
                        f"--scene {name}")
    return _SCENES[short]


def list_scenes() -> tuple[SceneSpec, ...]:
    """All registered scenes, by name."""
    _load_builtin()
    return tuple(_SCENES[name] for name in sorted(_SCENES))


def scenes_folder() -> Path:
    """Where the MJCF files of the built-in scenes lie: in the wheel, else in the checkout."""
    installed = Path(str(importlib.resources.files("simbench"))) / "_scenes"
    folder = installed if installed.is_dir() else Path(__file__).resolve().parent.parent / "scenes"
    if not folder.is_dir():
        raise BadFile(f"{folder}: the scene files are missing; install simbench again")
    return folder


def _load_builtin() -> None:
    importlib.import_module("simbench.scenes_builtin")


def _import_place(place: str) -> None:
    try:
        if place.endswith(".py"):
            found = importlib.util.spec_from_file_location(Path(place).stem, place)
            assert found is not None   # true of every name that ends in .py
            assert found.loader is not None
            found.loader.exec_module(importlib.util.module_from_spec(found))
        else:
            importlib.import_module(place)
    except (ImportError, OSError, SyntaxError) as error:
        raise BadFile(f"{place}: cannot be imported for its scenes: {error}") from error


def _did_you_mean(name: str, known: Iterable[str]) -> str:
    """What goes between a complaint and the hint that ends it."""
    by_lower = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.6)
    return f"; did you mean {by_lower[close[0]]!r}? " if close else "; "
