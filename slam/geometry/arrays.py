"""Shape checks that name the field, the shape wanted and the shape got."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class ShapeError(ValueError):
    """An array does not have the shape that its name promises."""


def check_shape(name: str, array: Array, wanted: tuple[int | str, ...],
                sizes: dict[str, int] | None = None) -> None:
    """Raise ShapeError unless `array` has the shape `wanted`.

    A letter stands for any size, but for the same size wherever it stands again in `sizes`.
    """
    sizes = {} if sizes is None else sizes
    got = np.shape(array)
    if not _fits(got, wanted, sizes):
        shown = ", ".join(f"{w}={sizes[w]}" if isinstance(w, str) and w in sizes else str(w)
                          for w in wanted)
        raise ShapeError(f"{name}: wanted shape ({shown}), got {tuple(got)}")


def _fits(got: tuple[int, ...], wanted: tuple[int | str, ...], sizes: dict[str, int]) -> bool:
    if len(got) != len(wanted):
        return False
    fits = True
    for size, want in zip(got, wanted, strict=True):
        if want != size and (not isinstance(want, str) or sizes.setdefault(want, size) != size):
            fits = False
    return fits


def freeze_fields(instance: object, **wanted: tuple[int | str, ...]) -> None:
    """Check the named array fields of a frozen dataclass and make them read-only views.

    Fields that are None are passed over.
    """
    sizes: dict[str, int] = {}
    for name, shape in wanted.items():
        value = getattr(instance, name)
        if value is None:
            continue
        array = np.asarray(value)
        if not _fits(array.shape, shape, sizes):
            check_shape(f"{type(instance).__name__}.{name}", array, shape, sizes)
        if array.flags.writeable or array is not value:
            array = array.view()
            array.flags.writeable = False
            object.__setattr__(instance, name, array)
