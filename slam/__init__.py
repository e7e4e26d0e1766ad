"""Dynamic point-line SLAM on RGB-D: camera and object motions from images, depth, flow, masks."""

from slam.systems.registry import SlamSystem, make

__all__ = ["SlamSystem", "make"]
