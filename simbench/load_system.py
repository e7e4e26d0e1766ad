"""A system by name: a preset of ours, or the user's own factory."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from simbench.errors import BadFile, UnknownName, UserError
from simbench.run import System
from simbench.settings import with_settings
from slam.systems import registry
from slam.types import Intrinsics


def load_system(name: str, intrinsics: Intrinsics, settings: Sequence[str] = ()
                ) -> tuple[System, dict[str, Any]]:
    """A fresh system and its resolved settings.

    Args:
        name: a preset (`simbench list`), `package.module:factory` or `path/to/file.py:factory`;
            a factory is called with the intrinsics and returns an object with `process` and
            `finish`.
        settings: "stage.field=value", for presets.
    Raises:
        UnknownName: no such preset, module, function or setting.
        UserError: a factory that fails, or returns what is no system.
    """
    if ":" not in name:
        try:
            config = with_settings(registry.default_config(name), settings)
        except registry.UnknownSystem as error:
            raise UnknownName(f"{error}; or give package.module:factory or file.py:factory"
                              ) from None
        return registry.make(name, intrinsics, config), _as_dict(config)
    if settings:
        raise UserError(f"--set {settings[0]}: the settings of {name} are its own; "
                        "--set is for the built-in systems")
    return _from_factory(name, intrinsics), {}


def _from_factory(name: str, intrinsics: Intrinsics) -> System:
    place, _, function = name.rpartition(":")
    module = _module(place, name)
    factory = getattr(module, function, None)
    if not callable(factory):
        known = [n for n, v in vars(module).items() if callable(v) and not n.startswith("_")]
        close = difflib.get_close_matches(function, known, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise UnknownName(f"--system {name}: {place} has no function {function!r}{hint}")
    try:
        system = factory(intrinsics)
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"--system {name}: {function}(intrinsics) raised "
                        f"{type(error).__name__}: {error}; mend it") from error
    if not (callable(getattr(system, "process", None))
            and callable(getattr(system, "finish", None))):
        raise UserError(f"--system {name}: {function}(intrinsics) gave "
                        f"{type(system).__name__}, wanted an object with process and finish")
    made: System = system
    return made


def _module(place: str, name: str) -> ModuleType:
    if "/" in place and not place.endswith(".py"):
        raise UnknownName(f"--system {name}: {place} is no Python file; wanted "
                          "path/to/file.py:factory or package.module:factory")
    try:
        return _file_module(Path(place)) if place.endswith(".py") else _named_module(place)
    except UserError:
        raise
    except ModuleNotFoundError as error:
        raise UnknownName(f"--system {name}: {error}; check the name, or install it") from error
    except Exception as error:
        raise UserError(f"--system {name}: importing {place} raised {type(error).__name__}: "
                        f"{error}; mend it") from error


def _file_module(path: Path) -> ModuleType:
    if not path.is_file():
        raise BadFile(f"{path}: no such file; give the path of a Python file")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None   # true of every name that ends in .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module   # dataclasses in it look themselves up here
    spec.loader.exec_module(module)
    return module


def _named_module(place: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    return importlib.import_module(place)


def _as_dict(config: object) -> dict[str, Any]:
    return asdict(config) if is_dataclass(config) and not isinstance(config, type) else {}
