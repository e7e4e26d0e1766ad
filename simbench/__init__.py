"""A benchmark for dynamic SLAM: simulated scenes with exact truth, sensors, metrics, reports."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import slam as _slam  # noqa: F401 (first: it finds a place for compiled loops before numba looks)
from simbench.envs import register_envs as _register_envs

if TYPE_CHECKING:
    import simbench.wrappers as wrappers  # noqa: PLR0402 (of itself it cannot import from)
    from simbench.run import evaluate as evaluate
    from simbench.scene import Dial as Dial
    from simbench.scene import SceneSpec as SceneSpec
    from simbench.scene import register_scene as register_scene
    from simbench.sequence import open_sequence as open_sequence
    from simbench.world import make_world as make_world

# Imported when first asked for, so that `import simbench` needs neither MuJoCo nor OpenGL.
_HOME = {
    "Dial": "simbench.scene",
    "SceneSpec": "simbench.scene",
    "register_scene": "simbench.scene",
    "make_world": "simbench.world",
    "open_sequence": "simbench.sequence",
    "evaluate": "simbench.run",
    "wrappers": "",
}

_register_envs()   # by name only: an environment loads MuJoCo when it is made

__all__ = ["Dial", "SceneSpec", "evaluate", "make_world", "open_sequence", "register_scene",
           "wrappers"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'simbench' has no attribute {name!r}")
    home = _HOME[name]
    return getattr(importlib.import_module(home), name) if home \
        else importlib.import_module(f"simbench.{name}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
