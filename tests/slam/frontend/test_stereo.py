"""Depth from a made-up stereo pair."""

from __future__ import annotations

import numpy as np
import pytest

from slam.frontend.stereo import depth_from_stereo
from slam.geometry.arrays import ShapeError
from slam.types import Intrinsics
from wave_pictures import picture

CAMERA = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240, baseline_m=0.2)


def pair(disparity):
    left = picture(size=(240, 320))
    right = picture(shift=(-disparity, 0.0), size=(240, 320))
    return np.dstack([left] * 3), np.dstack([right] * 3)


def test_a_fronto_parallel_plane():
    depth = depth_from_stereo(*pair(16.0), CAMERA)
    assert depth.dtype == np.float32
    seen = depth[:, 30:-5]
    assert (seen > 0).mean() > 0.9
    assert np.median(seen[seen > 0]) == pytest.approx(400.0 * 0.2 / 16.0, rel=0.01)


def test_nothing_without_texture():
    blank = np.full((240, 320, 3), 70, np.uint8)
    depth = depth_from_stereo(blank, blank, CAMERA)
    assert np.isfinite(depth).all()
    assert (depth >= 0).all()


def test_what_it_refuses():
    left, right = pair(8.0)
    with pytest.raises(ShapeError, match="right image"):
        depth_from_stereo(left, right[:-1], CAMERA)
    mono = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    with pytest.raises(ValueError, match="baseline_m"):
        depth_from_stereo(left, right, mono)
