"""The keyframe that frames lean on, and when another one is due."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.dpl.config import MappingConfig
from slam.dpl.keyframes import Keyframe
from slam.dpl.track import TrackedFrame


@dataclass(slots=True)
class Reference:
    """One keyframe, since the frame that made it or came back to it."""

    keyframe: Keyframe
    since: int               # row in the run
    most_held: int = 0       # landmarks in a frame since then

    def outgrown(self, tracked: TrackedFrame, row: int, config: MappingConfig) -> bool:
        """Whether a frame should become a keyframe; it counts among those since."""
        held = tracked.held
        self.most_held = max(self.most_held, held)
        fresh = np.count_nonzero((tracked.point_of < 0) & (tracked.features.points.depth_m > 0))
        return bool(row - self.since >= config.max_gap
                    or held < config.keyframe_share * self.most_held
                    or (held < config.min_points and fresh > held // 2))
