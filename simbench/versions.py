"""The versions of what the numbers may depend on."""

from __future__ import annotations

import platform
from functools import cache
from importlib import metadata

_PACKAGES = ("simbench-slam", "numpy", "scipy", "opencv-contrib-python-headless", "mujoco")


@cache
def versions() -> dict[str, str]:
    """Python's, and that of each package that is installed."""
    found = ((name, _version(name)) for name in _PACKAGES)
    return {"python": platform.python_version()} | {
        name: version for name, version in found if version}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""
