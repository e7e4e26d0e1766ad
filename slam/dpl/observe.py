"""What is kept of a frame: its features with depth, without those that move."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

from slam.dpl.config import DplConfig
from slam.dpl.culling import StillGround
from slam.dpl.epipolar import corners
from slam.dpl.features import Features, KeyLines
from slam.dpl.lines import LineDetector
from slam.dpl.movers import MoverCuller
from slam.dpl.orb import OrbDetector
from slam.dpl.picture import Picture
from slam.dpl.stereo import StereoMatcher
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics, Judged


@dataclass(frozen=True, slots=True)
class Observed:
    """What is kept of a frame, and why."""

    features: Features       # those that stay
    judged: Judged | None    # all that were found; None: nothing was tested for motion
    ground: StillGround | None   # where nothing was found to move; None: not tested


class FrameObserver:
    """Detects, on two threads; matches stereo pairs; leaves out what moves (III-A.1, III-B)."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config
        self.points = OrbDetector(config.orb, config.depth)
        self.lines = LineDetector(config.lines)
        # Many in the right picture, so that most of the left ones have a partner there.
        self.right_points = OrbDetector(replace(config.orb, count=2 * config.orb.count))
        self.movers = MoverCuller(camera, config)
        self.stereo = StereoMatcher(camera, config.stereo, config.orb.scale)
        self._beside = ThreadPoolExecutor(1)     # cv2 lets go of the interpreter's lock

    def __call__(self, picture: Picture, frame: Frame, T_a_b: Array, lap: Callable[[str], None]
                 ) -> Observed:
        """The features that stay, and what was judged of all of them.

        Args:
            T_a_b: (4, 4) the motion expected since the last frame.
            lap: called with the name of each stage that has ended.
        """
        culls = self.config.cull.enabled
        pair = self._right_of(frame, picture)
        lines = self._beside.submit(self._lines_of, picture, pair)
        # Of use after the lines only: to the pose's fit, and with the next frame.
        if self.config.anchors.enabled:
            self._beside.submit(lambda: picture.smooth)
        if culls:
            later = self._beside.submit(corners, picture.gray, self.config.cull.corners)
        points = [self.points(picture.gray, picture.depth_m),
                  *(self.right_points(each.gray) for each in pair)]
        lap("points")
        if culls:
            moved = self.movers.test(picture.gray, picture.depth_m, frame.boxes, T_a_b,
                                     later.result)
            lap("movers")
        whole, *right = (Features(p, q) for p, q in zip(points, lines.result(), strict=True))
        lap("wait for lines")
        self.stereo.fault = ""           # of a pair before, if this frame is none
        if pair:
            whole = self.stereo(whole, right[0], picture.smooth, pair[0].smooth)
            whole = whole.shifted(picture.depth_offset)
            lap("stereo")
        if not culls:
            return Observed(whole, None, None)
        culled = self.movers.cull(whole, moved, frame.stamp_s)
        lap("cull")
        return Observed(
            Features(whole.points[culled.points], whole.lines[culled.lines]),
            Judged(whole.points.uv_px, ~culled.points, whole.lines.ends_px, ~culled.lines),
            culled.ground)

    def _right_of(self, frame: Frame, picture: Picture) -> list[Picture]:
        """The right picture, where depth must come from it."""
        if frame.right is None or self.camera.baseline_m is None or picture.depth_m.any():
            return []
        return [Picture.without_depth(frame.right)]

    def _lines_of(self, picture: Picture, pair: list[Picture]) -> list[KeyLines]:
        return [self.lines(each.gray, each.depth_m) for each in (picture, *pair)]
