"""What property tests draw: rigid motions, points, lines, cameras."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.line import PluckerLines, plucker_from_points
from slam.types import Intrinsics


def reals(limit: float) -> st.SearchStrategy[float]:
    """Numbers in [-limit, limit]. Below 1e-9 only 0: that is beneath any length we measure."""
    return st.floats(-limit, limit, allow_subnormal=False).map(
        lambda x: x if abs(x) > 1e-9 else 0.0)


def vectors(*shape: int, limit: float) -> st.SearchStrategy[Array]:
    """Arrays of the given shape with elements of `reals(limit)`."""
    return hnp.arrays(np.float64, shape, elements=reals(limit))


def _normalised(v: Array) -> Array:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 1e-3, v, [1.0, 0.0, 0.0]) / np.where(length > 1e-3, length, 1.0)


def unit_vectors(*shape: int) -> st.SearchStrategy[Array]:
    """Directions (*shape, 3)."""
    return vectors(*shape, 3, limit=1.0).map(_normalised)


def rotation_angles() -> st.SearchStrategy[float]:
    """Angles in [0, π], the ends and their neighbourhoods drawn often."""
    return st.one_of(st.floats(0.0, np.pi),
                     st.floats(-16.0, -3.0).map(lambda e: 10.0**e),
                     st.floats(-16.0, -3.0).map(lambda e: np.pi - 10.0**e),
                     st.sampled_from([0.0, np.pi]))


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    """Rotation vectors (3,) of length at most π."""
    return np.asarray(draw(rotation_angles()) * draw(unit_vectors()))


@st.composite
def rigid_transforms(draw: st.DrawFn, reach_m: float = 10.0) -> Array:
    """Transforms (4, 4): any rotation, translations up to `reach_m` along each axis."""
    R = se3.exp_so3(draw(rotation_vectors()))
    return se3.from_rotation_translation(R, draw(vectors(3, limit=reach_m)))


def world_points(count: int = 5, reach_m: float = 10.0) -> st.SearchStrategy[Array]:
    """Points (count, 3) in metres, in any direction."""
    return vectors(count, 3, limit=reach_m)


@st.composite
def points_in_front(draw: st.DrawFn, count: int = 5) -> Array:
    """Points (count, 3) in a camera's frame, 0.2 m to 50 m away, within a wide field of view."""
    depth = draw(hnp.arrays(np.float64, (count, 1), elements=st.floats(0.2, 50.0)))
    slope = draw(vectors(count, 2, limit=1.5))
    return np.concatenate([slope * depth, depth], axis=1)


@st.composite
def plucker_lines(draw: st.DrawFn, count: int = 5, reach_m: float = 10.0) -> PluckerLines:
    """Lines through points within `reach_m`; some pass through the origin."""
    A = draw(world_points(count, reach_m))
    return plucker_from_points(A, A + draw(unit_vectors(count)))


@st.composite
def cameras(draw: st.DrawFn) -> Intrinsics:
    """Pinhole cameras of common sizes."""
    width, height = draw(st.sampled_from([(640, 480), (1242, 375), (64, 48)]))
    fx = draw(st.floats(0.4 * width, 2.0 * width))
    return Intrinsics(fx=fx, fy=fx * draw(st.floats(0.9, 1.1)), cx=(width - 1) / 2,
                      cy=(height - 1) / 2, width=width, height=height)
