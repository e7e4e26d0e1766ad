"""A suite as its YAML file says it: cases, what is swept in each, systems, seeds, metrics."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from simbench.errors import UnknownName, UserError
from simbench.inputs import InputChoice

SCHEMA = 1
INPUTS = ("flow", "masks", "boxes", "detector", "depth", "sensor", "flow_sigma", "flow_noise",
          "flow_shape")
SENSOR, SETTING = "sensor.", "set."      # of a sweep: sensor.depth.max_m, set.motion.kernel
_FIELDS = {"flow_sigma": "flow_sigma_px", "flow_noise": "flow_noise_kind",
           "flow_shape": "flow_noise_shape"}

Value = float | int | str
Point = tuple[tuple[str, Value], ...]    # what is swept, with its value here


@dataclass(frozen=True, slots=True)
class SequenceSpec:
    """What decides the frames of a rendered scene, or a folder as it was recorded."""

    scene: str = ""
    folder: str = ""
    calibration: str = ""
    dials: tuple[tuple[str, float | str], ...] = ()
    seed: int = 0
    frames: int | None = None
    size: tuple[int, int] | None = None
    fps: float | None = None
    stereo: bool = False            # of a scene: frames have a right picture


@dataclass(frozen=True, slots=True)
class Case:
    """One scene or recording of a suite, with what is swept on it."""

    name: str
    scene: str = ""
    folder: str = ""
    calibration: str = ""
    frames: int | None = None
    size: tuple[int, int] | None = None
    fps: float | None = None
    dials: Mapping[str, float | str] = field(default_factory=dict)
    inputs: Mapping[str, Value] = field(default_factory=dict)
    sensor_settings: Mapping[str, Value] = field(default_factory=dict)
    settings: tuple[str, ...] = ()
    sweep: tuple[tuple[str, tuple[Value, ...]], ...] = ()

    def points(self) -> list[Point]:
        """Every combination of the swept values; one empty point where nothing is swept."""
        names = [name for name, _ in self.sweep]
        return [tuple(zip(names, values, strict=True))
                for values in itertools.product(*(values for _, values in self.sweep))]

    def at(self, point: Point) -> Case:
        """This case with the swept values put in, and nothing swept any more."""
        dials, inputs = dict(self.dials), dict(self.inputs)
        sensor, settings = dict(self.sensor_settings), list(self.settings)
        for name, value in point:
            if name in INPUTS:
                inputs[name] = value
            elif name.startswith(SENSOR):
                sensor[name.removeprefix(SENSOR)] = value
            elif name.startswith(SETTING):
                settings.append(f"{name.removeprefix(SETTING)}={value}")
            else:
                dials[name] = value if isinstance(value, str) else float(value)
        return replace(self, dials=dials, inputs=inputs, sensor_settings=sensor,
                       settings=tuple(settings), sweep=())

    def sequence(self, seed: int) -> SequenceSpec:
        """The frames of this case, nothing swept any more, at a seed."""
        return SequenceSpec(self.scene, self.folder, self.calibration,
                            tuple(sorted(self.dials.items())), 0 if self.folder else seed,
                            self.frames, self.size, self.fps,
                            bool(self.scene) and self.inputs.get("depth") == "stereo")

    def choice(self) -> InputChoice:
        """What the systems are given. On scenes what is not named is true, but a sensor's depth.

        Raises:
            UserError: an input that there is not.
        """
        named: dict[str, Any] = {_FIELDS.get(name, name): value
                                 for name, value in self.inputs.items()}
        if self.scene:
            sensor = named.get("sensor") is not None
            named = {"flow": "truth", "masks": "truth", "depth": "sensor" if sensor else "truth",
                     **named}
        return InputChoice(**named, sensor_settings=dict(self.sensor_settings))


@dataclass(frozen=True, slots=True)
class Suite:
    """All of a suite: its runs are cases × points × systems × seeds."""

    name: str
    version: int
    description: str
    cases: tuple[Case, ...]
    systems: tuple[str, ...]
    seeds: tuple[int, ...]
    metrics: tuple[str, ...]

    def cells(self) -> Iterator[tuple[Case, Point]]:
        """Each case at each of its points, in the file's order."""
        return ((case, point) for case in self.cases for point in case.points())

    def changed(self, *, systems: tuple[str, ...] | None = None,
                seeds: tuple[int, ...] | None = None, frames: int | None = None,
                size: tuple[int, int] | None = None) -> Suite:
        """The suite with other systems, seeds, frames or image size where they are given."""
        cases = tuple(replace(case, frames=frames or case.frames,
                              size=case.size if case.folder else size or case.size)
                      for case in self.cases)
        return replace(self, cases=cases, systems=systems or self.systems,
                       seeds=self.seeds if seeds is None else seeds)

    def with_cases(self, names: tuple[str, ...]) -> Suite:
        """The suite with these of its cases. Raises UnknownName when it has no such case."""
        known = [case.name for case in self.cases]
        for name in names:
            if name not in known:
                raise UnknownName(f"suite {self.name} has no case {name!r}; it has "
                                  f"{', '.join(known)}")
        return replace(self, cases=tuple(case for case in self.cases if case.name in names))

    def as_json(self) -> dict[str, Any]:
        """The suite as results.json holds it."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self) if f.name != "cases"} \
            | {"cases": [{f.name: _plain(getattr(case, f.name)) for f in fields(case)
                          if getattr(case, f.name)} for case in self.cases]}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple):
        return [_plain(inner) for inner in value]
    return value


def point_text(point: Point) -> str:
    """"texture=0.5, flow=dis"."""
    return ", ".join(f"{name}={value_text(value)}" for name, value in point)


def value_text(value: Value) -> str:
    """A number in its shortest form, a word as it is."""
    return value if isinstance(value, str) else f"{value:g}"


def parse_seeds(text: str | int) -> tuple[int, ...]:
    """"0-4", "0,3,7", "0-2,10" or a single number. Raises UserError."""
    found: list[int] = []
    for part in str(text).split(","):
        low, dash, high = part.strip().partition("-")
        if not low.isdecimal() or (dash and not high.isdecimal()):
            raise UserError(f"seeds {text!r}: wanted numbers and ranges, as in 0-9 or 0,3,7")
        first, last = int(low), int(high or low)
        if last < first or last - first >= 10_000:
            raise UserError(f"seeds {text!r}: {part.strip()} does not go upward, or by more "
                            "than 10000; wanted the lower seed first, as in 2-5")
        found += range(first, last + 1)
    if len(set(found)) < len(found):
        raise UserError(f"seeds {text!r}: a seed is named twice")
    return tuple(found)
