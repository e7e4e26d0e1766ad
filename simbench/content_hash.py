"""What bytes a system was really given: two machines may draw a scene with other last bits."""

from __future__ import annotations

import hashlib

import numpy as np

from simbench.run import Feeds
from simbench.sequence import Sequence
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics


class HashedFeed:
    """A feed that keeps the SHA-256 of all frames it has handed out, in their order."""

    def __init__(self, feed: Feeds) -> None:
        self._feed = feed
        self._digest = hashlib.sha256()

    @property
    def intrinsics(self) -> Intrinsics:
        return self._feed.intrinsics

    @property
    def sequence(self) -> Sequence:
        return self._feed.sequence

    def __len__(self) -> int:
        return len(self._feed)

    def frame(self, k: int) -> Frame:
        """Frame k of the feed. Raises BadFrame as the feed does."""
        frame = self._feed.frame(k)
        flow = frame.flow
        boxes = frame.boxes
        for array in (frame.rgb, frame.depth_m, frame.instance_id, frame.right,
                      None if flow is None else flow.flow_px,
                      None if flow is None else flow.valid,
                      *(() if boxes is None else (boxes.corners_px, boxes.score, boxes.label))):
            self._add(array)
        return frame

    def true_object_of_label(self, k: int) -> dict[int, int]:
        return self._feed.true_object_of_label(k)

    def hexdigest(self) -> str:
        """SHA-256 of what was handed out so far."""
        return self._digest.hexdigest()

    def _add(self, array: Array | None) -> None:
        self._digest.update(b"none" if array is None else repr(array.shape).encode())
        if array is not None:
            self._digest.update(np.ascontiguousarray(array).data)
