"""Everything of two frames that goes into the solver, and which feature tracks it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.tables import joined, taken


@dataclass(frozen=True)
class Matched:
    """Correspondences of all groups: cells of the grid, corners and lines."""

    grid: PointMatches
    corners: PointMatches
    slopes: Array              # (N, 2) of the corners' inverse depth, 1/m/px
    corner_index: Array        # (N,) the corners' rows among the features of the previous frame
    lines: LineMatches
    line_index: Array          # (L,) the lines' rows among its segments

    @cached_property
    def every(self) -> PointMatches:
        """The cells, then the corners."""
        return joined(self.grid, self.corners)

    def points(self, parked: Array) -> PointMatches:
        """All points; those of parked groups count for the static world too."""
        if len(parked) == 0:
            return self.every
        still = taken(self.every, np.isin(self.every.group, parked))
        return joined(self.every, replace(still, group=np.zeros_like(still.group)))

    def without(self, groups: Array) -> Matched:
        """What is left when some groups are left out."""
        if len(groups) == 0:
            return self
        corners = np.flatnonzero(~np.isin(self.corners.group, groups))
        lines = np.flatnonzero(~np.isin(self.lines.group, groups))
        return Matched(taken(self.grid, ~np.isin(self.grid.group, groups)),
                       taken(self.corners, corners), self.slopes[corners],
                       self.corner_index[corners],
                       taken(self.lines, lines), self.line_index[lines])
