"""Run a system over a feed.

    record = run(system, feed)
    metrics = score(sequence.truth.trajectories, record)
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from collections.abc import Sequence as Listed
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from simbench.errors import BadFrame, UserError
from simbench.metrics.estimates import batch_camera
from simbench.record import RunRecord
from simbench.score import evaluate, score
from simbench.sequence import Sequence
from slam.geometry.arrays import Array
from slam.types import Frame, FrameEstimate, Intrinsics, SlamResult, Status

__all__ = ["Feeds", "Observer", "RunRecord", "System", "evaluate", "run", "score"]


class System(Protocol):
    """A SLAM system: our own, or any object with these two methods."""

    def process(self, frame: Frame) -> FrameEstimate: ...
    def finish(self) -> SlamResult: ...


class Feeds(Protocol):
    """What the run loop needs of a feed (simbench.inputs.Feed is one)."""

    @property
    def intrinsics(self) -> Intrinsics: ...
    @property
    def sequence(self) -> Sequence: ...
    def __len__(self) -> int: ...
    def frame(self, k: int) -> Frame: ...
    def true_object_of_label(self, k: int) -> dict[int, int]: ...


Observer = Callable[[Frame, FrameEstimate], None]
"""Looks at every frame that the system was given, and at its answer, outside the timed part."""


@dataclass(slots=True)
class _Recorder:
    """The lists a run fills."""

    estimates: list[FrameEstimate] = field(default_factory=list)
    labels: list[dict[int, int]] = field(default_factory=list)
    processed: list[bool] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    unreadable: dict[int, str] = field(default_factory=dict)

    def lose(self, k: int, stamp_s: float, reason: str, note: str = "") -> None:
        """Frame k has no estimate; the pose stays where it was."""
        pose = self.estimates[-1].T_world_camera if self.estimates else np.eye(4)
        self.estimates.append(FrameEstimate(k, stamp_s, pose, np.eye(4), status=Status.LOST,
                                            reason=reason))
        self.labels.append({})
        self.processed.append(False)
        self.ms.append(np.nan)
        self.log.append(f"frame {k}: lost: {reason}{note}")

    def keep(self, estimate: FrameEstimate, labels: dict[int, int], ms: float) -> None:
        self.estimates.append(estimate)
        self.labels.append(labels)
        self.processed.append(True)
        self.ms.append(ms)
        if estimate.status is Status.LOST or estimate.reason:
            self.log.append(f"frame {estimate.index}: {estimate.status}: {estimate.reason}")


def run(system: System, feed: Feeds, *, progress: Callable[[int], None] | None = None,
        observers: Listed[Observer] = ()) -> RunRecord:
    """Give a system every frame of a feed, in order.

    A frame that cannot be read, or on which the system raises, is marked lost with its reason;
    the run goes on and the log tells it.

    Args:
        progress: called with the number of frames done, after each.
        observers: called with each answered frame.
    Raises:
        UserError: the system cannot work on this input at all, and says so.
    """
    recorder = _Recorder()
    for k in range(len(feed)):
        _step(system, feed, k, recorder, observers)
        if progress is not None:
            progress(k + 1)
    processed = np.array(recorder.processed, dtype=bool)
    stamps_s = np.asarray(feed.sequence.stamps_s)[:len(feed)].copy()
    result, finish_s, fault = _finish(system, stamps_s, recorder.log)
    return RunRecord(stamps_s,
                     tuple(recorder.estimates), tuple(recorder.labels), processed,
                     np.array(recorder.ms), result, finish_s, tuple(recorder.log),
                     recorder.unreadable, fault)


def _step(system: System, feed: Feeds, k: int, recorder: _Recorder,
          observers: Listed[Observer]) -> None:
    stamp_s = float(feed.sequence.stamps_s[k])
    try:
        frame = feed.frame(k)
    except BadFrame as error:
        recorder.unreadable[k] = str(error)
        recorder.lose(k, stamp_s, str(error))
        return
    started = time.perf_counter()
    try:
        estimate = system.process(frame)
    except UserError:
        raise
    except Exception as error:
        recorder.lose(k, stamp_s, f"the system raised {type(error).__name__}: {error}",
                      "\n" + traceback.format_exc())
        return
    ms = 1e3 * (time.perf_counter() - started)
    fault = _fault_of(estimate)
    if fault:
        recorder.lose(k, stamp_s, f"the system returned {fault}")
        return
    recorder.keep(_without_bad_objects(estimate, recorder.log), feed.true_object_of_label(k), ms)
    for observer in observers:
        observer(frame, estimate)


def _finish(system: System, stamps_s: Array, log: list[str]
            ) -> tuple[SlamResult | None, float | None, str]:
    """The result and how long it took; without one, what was wrong."""
    started = time.perf_counter()
    try:
        result = system.finish()
        seconds = time.perf_counter() - started
        if not isinstance(result, SlamResult):
            fault = f"finish: the system returned {type(result).__name__}, wanted SlamResult"
            log.append(fault)
            return None, None, fault
        batch_camera(result, stamps_s)   # raises where a pose belongs to no frame
    except Exception as error:
        fault = f"finish: the system raised {type(error).__name__}: {error}"
        log.append(f"{fault}\n{traceback.format_exc()}")
        return None, None, fault
    return result, seconds, ""


def _is_motion(T: Array) -> bool:
    return bool(np.all(np.isfinite(T))) and \
        bool(np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max() < 1e-3)


def _fault_of(estimate: object) -> str:
    """Why an answer cannot be scored, or ""."""
    if not isinstance(estimate, FrameEstimate):
        return f"{type(estimate).__name__}, wanted FrameEstimate"
    if not (_is_motion(estimate.T_world_camera) and _is_motion(estimate.T_previous_camera)):
        return "a camera pose that is no rigid motion"
    return ""


def _without_bad_objects(estimate: FrameEstimate, log: list[str]) -> FrameEstimate:
    bad = [track for track, motion in estimate.objects.items()
           if not (_is_motion(motion.H_world) and np.all(np.isfinite(motion.centroid_world)))]
    for track in bad:
        log.append(f"frame {estimate.index}: track {track} left out: no rigid motion")
    if not bad:
        return estimate
    return replace(estimate, objects={track: motion for track, motion in estimate.objects.items()
                                      if track not in bad})
