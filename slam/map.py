"""What was observed over a run, as the back-end takes it: struct of arrays, body by body.

A body is the static world or a rigid object over one unbroken stretch of frames. Its landmarks
stand still in its own frame, and the camera has a pose there: T_body_camera.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.tables import joined

STATIC = 0         # the number of the static world among the bodies


@dataclass(frozen=True, slots=True)
class PointObservations:
    """M sightings of point landmarks, each with noise of its own."""

    landmark: Array      # (M,) int64
    frame: Array         # (M,) int64: row in the run
    uv_px: Array         # (M, 2)
    covariance: Array    # (M, 2, 2) px²
    rho: Array           # (M,) 1/m, inverse depth
    rho_sigma: Array     # (M,) 1/m; inf where unknown

    def __post_init__(self) -> None:
        freeze_fields(self, landmark=("M",), frame=("M",), uv_px=("M", 2),
                      covariance=("M", 2, 2), rho=("M",), rho_sigma=("M",))

    def __len__(self) -> int:
        return len(self.landmark)


@dataclass(frozen=True, slots=True)
class PointLandmarks:
    """P landmarks as they were first seen."""

    number: Array        # (P,) int64, ascending
    body: Array          # (P,) int64
    xyz_body: Array      # (P, 3) m

    def __post_init__(self) -> None:
        freeze_fields(self, number=("P",), body=("P",), xyz_body=("P", 3))

    def __len__(self) -> int:
        return len(self.number)


@dataclass(frozen=True, slots=True)
class LineObservations:
    """M sightings of line landmarks: two places on each, known across the line only."""

    landmark: Array      # (M,) int64
    frame: Array         # (M,) int64: row in the run
    ends_px: Array       # (M, 2, 2)
    covariance: Array    # (M, 2, 2) px² of both ends' offsets across the line
    rho: Array           # (M, 2) 1/m, inverse depth at the ends
    rho_sigma: Array     # (M, 2) 1/m; inf where unknown

    def __post_init__(self) -> None:
        freeze_fields(self, landmark=("M",), frame=("M",), ends_px=("M", 2, 2),
                      covariance=("M", 2, 2), rho=("M", 2), rho_sigma=("M", 2))

    def __len__(self) -> int:
        return len(self.landmark)


@dataclass(frozen=True, slots=True)
class LineLandmarks:
    """P lines as they were first seen."""

    number: Array        # (P,) int64, ascending; lines have numbers of their own
    body: Array          # (P,) int64
    line_body: Array     # (P, 10) as slam.line_sightings stores them

    def __post_init__(self) -> None:
        freeze_fields(self, number=("P",), body=("P",), line_body=("P", 10))

    def __len__(self) -> int:
        return len(self.number)


@dataclass(slots=True)
class BodyRecord:
    """The camera's path in one body's frame; grows by a pose a frame."""

    track: int                                               # object track; 0: static world
    frames: list[int] = field(default_factory=list)          # rows in the run, ascending
    poses: list[Array] = field(default_factory=list)         # (4, 4) T_body_camera, as known best
    steps: list[Array] = field(default_factory=list)         # (4, 4) to each pose, as tracked
    information: list[Array] = field(default_factory=list)   # (6, 6) that each step states
    # By which steps outweigh that in the partial batch: there, sightings count as if independent.
    weight: list[float] = field(default_factory=list)
    rigidity: list[float] = field(default_factory=list)      # share that moved as one body

    def begin(self, frame: int, T_body_camera: Array) -> None:
        """The first pose, which no step leads to."""
        self.frames.append(frame)
        self.poses.append(T_body_camera)
        self.steps.append(np.eye(4))
        self.information.append(np.zeros((6, 6)))
        self.weight.append(1.0)
        self.rigidity.append(1.0)

    def add(self, frame: int, step: Array, information: Array, rigidity: float = 1.0,
            weight: float = 1.0) -> None:
        """Go one step (4, 4) on from the last pose; `information` is 0 where it is not known."""
        self.frames.append(frame)
        self.poses.append(se3.orthonormalised(self.poses[-1] @ step))
        self.steps.append(step)
        self.information.append(information)
        self.weight.append(weight)
        self.rigidity.append(rigidity)


Landmarks = TypeVar("Landmarks", bound=PointLandmarks | LineLandmarks)
Observations = TypeVar("Observations", bound=PointObservations | LineObservations)


@dataclass(slots=True)
class Features(Generic[Landmarks, Observations]):
    """Landmarks of one kind and all their sightings; grows frame by frame."""

    no_landmarks: Landmarks
    no_observations: Observations
    _observations: list[Observations] = field(default_factory=list)
    _landmarks: list[Landmarks] = field(default_factory=list)
    _next_landmark: int = 0

    def add_landmarks(self, body: Array, place: Array) -> Array:
        """Give new landmarks their numbers (P,)."""
        numbers = np.arange(self._next_landmark, self._next_landmark + len(body), dtype=np.int64)
        self._next_landmark += len(body)
        self._landmarks.append(type(self.no_landmarks)(numbers, body, place))
        return numbers

    def add_observations(self, observations: Observations) -> None:
        self._observations.append(observations)

    def observations_of(self, frame: int) -> list[Observations]:
        """What was added of the newest frame, given as a row of the run."""
        out: list[Observations] = []
        for part in reversed(self._observations):
            if len(part) and part.frame[0] != frame:
                break
            out.insert(0, part)
        return out

    def landmarks_after(self, number: int) -> list[Landmarks]:
        """What was added after the landmark of this number."""
        out: list[Landmarks] = []
        for part in reversed(self._landmarks):
            if len(part) and part.number[0] <= number:
                break
            out.insert(0, part)
        return out

    def landmarks(self) -> Landmarks:
        """All landmarks so far."""
        return joined(self.no_landmarks, *self._landmarks)

    def observations(self) -> Observations:
        """All sightings so far, by frame."""
        return joined(self.no_observations, *self._observations)

    def forget(self) -> None:
        """Let go of all that was added; numbers go on from where they are."""
        self._observations.clear()
        self._landmarks.clear()


def no_observations() -> PointObservations:
    """An empty set."""
    none = np.zeros(0, np.int64)
    return PointObservations(none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0),
                             np.zeros(0))


def no_line_observations() -> LineObservations:
    """An empty set."""
    none = np.zeros(0, np.int64)
    return LineObservations(none, none, np.zeros((0, 2, 2)), np.zeros((0, 2, 2)),
                            np.zeros((0, 2)), np.zeros((0, 2)))


def _point_features() -> Features[PointLandmarks, PointObservations]:
    none = np.zeros(0, np.int64)
    return Features(PointLandmarks(none, none, np.zeros((0, 3))), no_observations())


def _line_features() -> Features[LineLandmarks, LineObservations]:
    none = np.zeros(0, np.int64)
    return Features(LineLandmarks(none, none, np.zeros((0, 10))), no_line_observations())


@dataclass(slots=True)
class MapRecord:
    """All bodies, landmarks and sightings of a run; grows frame by frame."""

    indices: list[int] = field(default_factory=list)         # the frame's own index, by row
    bodies: dict[int, BodyRecord] = field(default_factory=lambda: {STATIC: BodyRecord(0)})
    points: Features[PointLandmarks, PointObservations] = field(default_factory=_point_features)
    lines: Features[LineLandmarks, LineObservations] = field(default_factory=_line_features)
    step_correlation: float = 0.0      # of a tracked step's error with the next one's, so far

    def new_body(self, track: int) -> int:
        """Begin a body for an object track; its number."""
        number = max(self.bodies) + 1
        self.bodies[number] = BodyRecord(track)
        return number
