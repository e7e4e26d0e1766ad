"""Points and lines of one frame, with descriptors and depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.estimation.calibration import shifted_depth
from slam.geometry.arrays import Array, freeze_fields

_TWO_CORNERS_PX = float(np.sqrt(2.0 / 12.0))     # standard deviation between two whole pixels


@dataclass(frozen=True, slots=True)
class KeyPoints:
    """N oriented points."""

    uv_px: Array         # (N, 2)
    level: Array         # (N,) int32 of the pyramid, 0 the finest
    angle_deg: Array     # (N,)
    descriptor: Array    # (N, 32) uint8
    depth_m: Array       # (N,) z-depth, 0 where unknown
    whitening: Array | None = None   # (N, 4) of what is known better than as detected, else 0:
                                     # lower triangle (uu, vu, vv) of L⁻¹, Σ = L Lᵀ px²; 1/σ of 1/z

    def __post_init__(self) -> None:
        freeze_fields(self, uv_px=("N", 2), level=("N",), angle_deg=("N",),
                      descriptor=("N", 32), depth_m=("N",), whitening=("N", 4))

    def __len__(self) -> int:
        return len(self.uv_px)

    def __getitem__(self, rows: Array) -> KeyPoints:
        return KeyPoints(self.uv_px[rows], self.level[rows], self.angle_deg[rows],
                         self.descriptor[rows], self.depth_m[rows],
                         None if self.whitening is None else self.whitening[rows])

    def known_better(self) -> Array:
        """(N, 4) whitening that may be written to; 0 of points that are as detected."""
        return np.zeros((len(self), 4)) if self.whitening is None else self.whitening.copy()


@dataclass(frozen=True, slots=True)
class KeyLines:
    """L segments; of some of them the depth of both ends is known."""

    ends_px: Array       # (L, 2, 2)
    descriptor: Array    # (L, 32) uint8
    depth_m: Array       # (L, 2) z-depth of both ends, 0 where unknown

    def __post_init__(self) -> None:
        freeze_fields(self, ends_px=("L", 2, 2), descriptor=("L", 32), depth_m=("L", 2))

    def __len__(self) -> int:
        return len(self.ends_px)

    def __getitem__(self, rows: Array) -> KeyLines:
        return KeyLines(self.ends_px[rows], self.descriptor[rows], self.depth_m[rows])


@dataclass(frozen=True, slots=True)
class Features:
    """What is kept of a frame."""

    points: KeyPoints
    lines: KeyLines

    def shifted(self, offset: float) -> Features:
        """The same with an offset, 1/m, added to every inverse depth that is known."""
        return Features(
            replace(self.points, depth_m=shifted_depth(self.points.depth_m, offset)),
            replace(self.lines, depth_m=shifted_depth(self.lines.depth_m, offset)))

    def of_any_landmark(self, scale: float) -> Features:
        """The same, to be held against other landmarks than those their keyframe knew them as.

        What is known to a small fraction of a pixel is where a feature's own landmark is. Another
        landmark of the same thing began as another corner, a whole pixel of its level as this one.
        """
        whitening = self.points.whitening
        if whitening is None:
            return self
        better = np.flatnonzero(whitening[:, 0] > 0)
        across = 1.0 / (_TWO_CORNERS_PX * scale ** self.points.level[better].astype(np.float64))
        whitening = whitening.copy()
        whitening[better, :3] = across[:, None] * [1.0, 0.0, 1.0]
        return replace(self, points=replace(self.points, whitening=whitening))


def joined(a: KeyPoints, b: KeyPoints) -> KeyPoints:
    """The points of both, a's first."""
    return KeyPoints(np.concatenate([a.uv_px, b.uv_px]), np.concatenate([a.level, b.level]),
                     np.concatenate([a.angle_deg, b.angle_deg]),
                     np.concatenate([a.descriptor, b.descriptor]),
                     np.concatenate([a.depth_m, b.depth_m]),
                     np.concatenate([a.known_better(), b.known_better()]))


def no_points() -> KeyPoints:
    return KeyPoints(np.zeros((0, 2)), np.zeros(0, np.int32), np.zeros(0),
                     np.zeros((0, 32), np.uint8), np.zeros(0))


def no_lines() -> KeyLines:
    return KeyLines(np.zeros((0, 2, 2)), np.zeros((0, 32), np.uint8), np.zeros((0, 2)))
