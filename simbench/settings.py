"""`--set STAGE.FIELD=VALUE`: fields of nested frozen dataclasses, set from text."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from simbench.errors import UnknownName, UserError

_Config = TypeVar("_Config")
SIGNED = "signed"     # in the metadata of fields whose numbers may be negative
_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def with_settings(config: _Config, settings: Iterable[str]) -> _Config:
    """A copy of a configuration with fields set by "stage.field=value", the last one winning.

    Raises:
        UnknownName: no such stage or field; the message names the closest.
        UserError: not STAGE.FIELD=VALUE, or a value that is not of the field's type.
    """
    for text in settings:
        path, equals, value = text.partition("=")
        if not equals or not path:
            raise UserError(f"--set {text}: wanted STAGE.FIELD=VALUE")
        config = _with(config, path.strip().split("."), value.strip(), text)
    return config


def _with(config: Any, path: list[str], value: str, text: str) -> Any:
    name, *rest = path
    known = {f.name: f for f in fields(config)}
    names = list(known)
    if name not in known:
        inside = [f"{n}.{name}" for n in names if is_dataclass(getattr(config, n))
                  and hasattr(getattr(config, n), name)]
        close = inside or difflib.get_close_matches(name, names, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}?" if close else "."
        raise UnknownName(f"--set {text}: no setting {name!r}{hint} There are {', '.join(names)}")
    held = getattr(config, name)
    if is_dataclass(held):
        if not rest:
            inner = ", ".join(f"{name}.{f.name}" for f in fields(held))
            raise UserError(f"--set {text}: {name!r} is a stage; set one of {inner}")
        return replace(config, **{name: _with(held, rest, value, text)})
    if rest:
        raise UnknownName(f"--set {text}: {name!r} has no fields of its own")
    converted = _converted(value, get_type_hints(type(config))[name], text)
    if isinstance(converted, int | float) and not known[name].metadata.get(SIGNED, False):
        _not_negative(converted, text)
    try:
        return replace(config, **{name: converted})
    except ValueError as error:
        raise UserError(f"--set {text}: {error}") from None


def _converted(value: str, wanted: Any, text: str) -> Any:
    if get_origin(wanted) in (Union, types.UnionType):
        return _of_union(value, get_args(wanted), text)
    if get_origin(wanted) is Literal:
        for choice in get_args(wanted):
            if str(choice) == value:
                return choice
        raise UserError(f"--set {text}: wanted one of {', '.join(map(str, get_args(wanted)))}")
    if wanted is bool:
        if value.lower() not in _TRUE + _FALSE:
            raise UserError(f"--set {text}: wanted true or false")
        return value.lower() in _TRUE
    if wanted in (int, float):
        try:
            return wanted(value)
        except ValueError:
            kind = "a whole number" if wanted is int else "a number"
            raise UserError(f"--set {text}: {value!r} is not {kind}") from None
    if wanted is str:
        return value
    raise UserError(f"--set {text}: this field cannot be set from the command line")


def _not_negative(number: float, text: str) -> None:
    """Counts, widths and tolerances begin at 0; inf switches a limit off."""
    if not number >= 0:      # nor is NaN
        kind = "a whole number" if isinstance(number, int) else "a number"
        raise UserError(f"--set {text}: must not be negative; wanted {kind} from 0")


def _of_union(value: str, choices: tuple[Any, ...], text: str) -> Any:
    if type(None) in choices and value.lower() in ("none", "null"):
        return None
    return _converted(value, next(c for c in choices if c is not type(None)), text)
