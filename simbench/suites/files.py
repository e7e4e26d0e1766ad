"""Suites from YAML: those of the package by name, the user's own by path."""

from __future__ import annotations

import difflib
import importlib.resources
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simbench.errors import BadFile, UnknownName, UserError
from simbench.metric_names import SHOWN, find_metric
from simbench.scene import find_scene
from simbench.sensors.spec import find_sensor
from simbench.suites.spec import (
    INPUTS,
    SCHEMA,
    SENSOR,
    SETTING,
    Case,
    Suite,
    Value,
    parse_seeds,
)
from simbench.untrusted import read_yaml

_MOST_BYTES = 1_000_000
_MOST_RUNS = 100_000
_TOP = ("schema", "name", "version", "description", "systems", "seeds", "metrics", "defaults",
        "cases")
_OF_CASE = ("scene", "folder", "calibration", "frames", "size", "fps", "dials", "set", "sweep",
            "sensor_settings", *INPUTS)
_NAME = re.compile(r"[A-Za-z0-9][\w.+-]*")


def list_suites() -> list[str]:
    """The names of the suites in the package."""
    return sorted(path.name.removesuffix(".yaml") for path in _builtin().iterdir()
                  if path.name.endswith(".yaml"))


def load_suite(name: str) -> Suite:
    """A suite of the package by name, or of a YAML file by path.

    Raises:
        UnknownName: no such suite.
        BadFile: the file cannot be read, or is no suite; the message says where.
    """
    if name.endswith((".yaml", ".yml")) or "/" in name:
        return read_suite(Path(name))
    known = list_suites()
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}? There" if close else "; there"
        raise UnknownName(f"no suite {name!r}{hint} are {', '.join(known)}, as `simbench list "
                          "NAME` shows them; or give the path of a YAML file")
    return read_suite(Path(str(_builtin() / f"{name}.yaml")))


def suite_text(name: str) -> str:
    """The file of one of the package's suites."""
    return str((_builtin() / f"{name}.yaml").read_text(encoding="utf-8"))


def read_suite(path: Path) -> Suite:
    """The suite in a YAML file. Nothing in it is executed.

    Raises:
        BadFile: it cannot be read, or a key or value is wrong; the message says which.
    """
    value = read_yaml(path, "give the YAML file of a suite", _MOST_BYTES)
    try:
        return _suite(value)
    except UserError as error:
        raise BadFile(f"{path}: {error}") from None


def _builtin() -> Any:
    return importlib.resources.files("simbench.suites") / "builtin"


def _suite(value: Any) -> Suite:
    top = _mapping(value, "", _TOP)
    if top.get("schema") != SCHEMA:
        raise UserError(f"schema is {top.get('schema')!r}, wanted {SCHEMA}")
    cases = top.get("cases")
    if not isinstance(cases, Mapping) or not cases:
        raise UserError("cases: wanted a mapping of at least one name to a case")
    defaults = _mapping(top.get("defaults") or {}, "defaults", _OF_CASE)
    suite = Suite(
        name=_name(top.get("name"), "name"), version=_whole(top.get("version", 1), "version"),
        description=str(top.get("description", "")),
        cases=tuple(_case(name, body, defaults) for name, body in cases.items()),
        systems=_names(top.get("systems"), "systems"), seeds=_seeds(top.get("seeds", "0-4")),
        metrics=_names(top.get("metrics", list(SHOWN)), "metrics"))
    for metric in suite.metrics:
        find_metric(metric)
    runs = sum(math.prod(len(v) for _, v in case.sweep) for case in suite.cases) \
        * len(suite.systems) * len(suite.seeds)
    if runs > _MOST_RUNS:
        raise UserError(f"{runs} runs; at most {_MOST_RUNS}")
    return suite


def _case(name: Any, body: Any, defaults: Mapping[str, Any]) -> Case:
    where = f"case {name}"
    own = _mapping(body or {}, where, _OF_CASE)
    merged = {**defaults, **own}
    for key in ("dials", "sweep", "sensor_settings"):
        merged[key] = {**_mapping(defaults.get(key) or {}, f"defaults: {key}"),
                       **_mapping(own.get(key) or {}, f"{where}: {key}")}
    if bool(merged.get("scene")) == bool(merged.get("folder")):
        raise UserError(f"{where}: wanted either scene or folder")
    case = Case(
        name=_name(name, "cases"), scene=str(merged.get("scene") or ""),
        folder=str(merged.get("folder") or ""), calibration=str(merged.get("calibration") or ""),
        frames=None if merged.get("frames") is None else _whole(merged["frames"],
                                                                f"{where}: frames"),
        size=_size(merged.get("size"), where),
        fps=None if merged.get("fps") is None else _number(merged["fps"], f"{where}: fps"),
        dials={key: _dial(v, f"{where}: dial {key}") for key, v in merged["dials"].items()},
        inputs={key: _value(merged[key], f"{where}: {key}") for key in INPUTS if key in merged},
        sensor_settings={key: _value(v, f"{where}: sensor_settings: {key}")
                         for key, v in merged["sensor_settings"].items()},
        settings=_names(merged.get("set") or [], f"{where}: set", least=0),
        sweep=tuple((key, _swept(v, f"{where}: sweep: {key}"))
                    for key, v in merged["sweep"].items()))
    for point in case.points():
        _check_inputs(case.at(point), where)
        _check_words(case.at(point), where)
    return case


def _check_inputs(case: Case, where: str) -> None:
    """A wrong input is named before anything is rendered."""
    if isinstance(case.inputs.get("flow_sigma", 0), str):
        raise UserError(f"{where}: flow_sigma: {case.inputs['flow_sigma']!r} is not a number")
    choice = case.choice()
    try:
        find_sensor(choice.sensor or "ideal", choice.sensor_settings)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None


def _check_words(case: Case, where: str) -> None:
    """A word is the value of a dial with named values only."""
    words = {name: value for name, value in case.dials.items() if isinstance(value, str)}
    named = {dial.name for dial in find_scene(case.scene).dials if dial.choices} if words else ()
    for name, value in words.items():
        if name not in named:
            raise UserError(f"{where}: {name}: {value!r} is not a number")


def _swept(value: Any, where: str) -> tuple[Value, ...]:
    if not isinstance(value, list) or not value:
        raise UserError(f"{where}: wanted a list of values")
    values = tuple(_value(each, where) for each in value)
    if len(set(values)) < len(values):
        raise UserError(f"{where}: a value stands there twice")
    name = where.rpartition(": ")[2]
    if name not in INPUTS and not name.startswith((SENSOR, SETTING)):
        values = tuple(_dial(each, where) for each in values)
    return values


def _mapping(value: Any, where: str, known: tuple[str, ...] | None = None) -> dict[str, Any]:
    at = f"{where}: " if where else ""      # the file itself stands before every message
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise UserError(f"{at}wanted a mapping of names to values")
    for key in value if known is not None else ():
        if known is not None and key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(known)}"
            raise UserError(f"{at}no key {key!r}{hint}")
    return dict(value)


def _value(value: Any, where: str) -> Value:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)) \
            or (isinstance(value, float) and not math.isfinite(value)):
        raise UserError(f"{where}: {value!r} is neither a number nor a word; quote words such as "
                        "'none'" if value is None or isinstance(value, bool) else
                        f"{where}: {value!r} is neither a finite number nor a word")
    return value


def _dial(value: Any, where: str) -> float | str:
    """A number, or the name of a choice, of which the scene knows whether it has it."""
    value = _value(value, where)
    return value if isinstance(value, str) else float(value)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise UserError(f"{where}: {value!r} is not a number")
    return float(value)


def _whole(value: Any, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise UserError(f"{where}: {value!r} is not a whole number from 1")
    return value


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise UserError(f"{where}: {value!r} is no name of letters, digits, . _ + and -")
    return value


def _names(value: Any, where: str, least: int = 1) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) < least \
            or not all(isinstance(each, str) for each in value):
        raise UserError(f"{where}: wanted a list of names")
    if len(set(value)) < len(value):
        raise UserError(f"{where}: a name stands there twice")
    return tuple(value)


def _seeds(value: Any) -> tuple[int, ...]:
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise UserError(f"seeds: {value!r} is no range; wanted as in 0-9 or 0,3,7")
    return parse_seeds(value)


def _size(value: Any, where: str) -> tuple[int, int] | None:
    match = None if value is None else re.fullmatch(r"(\d{1,4})x(\d{1,4})", str(value))
    if value is not None and match is None:
        raise UserError(f"{where}: size {value!r}: wanted width and height as in 640x480")
    return None if match is None else (int(match[1]), int(match[2]))
