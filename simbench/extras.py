"""How to install what only some commands need."""

from __future__ import annotations


def how_to_install(extra: str) -> str:
    """What to type for one of the extras in pyproject.toml; the package is on no index yet."""
    return f"in simbench's checkout: pip install -e '.[{extra}]'"
