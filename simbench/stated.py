"""Values that a file states, of the type and the range that they must have, or a ValueError."""

from __future__ import annotations

import sys
from typing import Any

MOST_SEED, MOST_FRAMES = 2**63, 1_000_000


def whole(value: Any, key: str, low: int, high: int) -> int:
    """A whole number from `low` to `high`."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{key} is {value!r:.40}, wanted a whole number from {low} to {high}")
    return value


def number(value: Any, key: str, farthest: float = sys.float_info.max) -> float:
    """A number not farther than that from 0."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) \
            or not abs(value) <= farthest:
        raise ValueError(f"{key} is {value!r:.40}, wanted a number")
    return value


def not_negative(value: Any, key: str) -> float:
    """A number of 0 or more."""
    if number(value, key) < 0:
        raise ValueError(f"{key} is {value!r:.40}, wanted a number of 0 or more")
    return float(value)


def text(value: Any, key: str) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ValueError(f"{key} is {value!r:.40}, wanted a text")
    return value


def items(value: Any, key: str, count: int | None = None) -> list[Any]:
    """A list, of `count` items where that is given."""
    if not isinstance(value, list) or count not in (None, len(value)):
        raise ValueError(f"{key} is {value!r:.40}, wanted a list"
                         + (f" of {count}" if count else ""))
    return value


def mapping(value: Any, key: str) -> dict[str, Any]:
    """A mapping."""
    if not isinstance(value, dict):
        raise ValueError(f"{key} is {value!r:.40}, wanted a mapping")
    return value
