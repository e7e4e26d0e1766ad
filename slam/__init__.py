"""Dynamic point-line SLAM on RGB-D: camera and object motions from images, depth, flow, masks."""

from slam.loop_cache import find_place as _find_place

_find_place()      # before numba is imported, by the very next line

from slam.systems.registry import SlamSystem, make  # noqa: E402

__all__ = ["SlamSystem", "make"]
