"""Structs of arrays as tables: rows picked, and tables put one after another."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from slam.geometry.arrays import Array

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Table = TypeVar("Table", bound="DataclassInstance")
"""A dataclass whose fields are all arrays with one entry a row."""


def joined(*parts: Table) -> Table:
    """The rows of all parts, one after another."""
    return type(parts[0])(*(np.concatenate([getattr(p, f.name) for p in parts])
                            for f in fields(parts[0])))


def taken(table: Table, index: Array | slice) -> Table:
    """The rows that `index` picks: numbers, a mask or a slice."""
    return type(table)(*(getattr(table, f.name)[index] for f in fields(table)))
