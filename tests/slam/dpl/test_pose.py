"""Poses from points, from lines alone, and past outliers."""

import numpy as np
import pytest

from slam.dpl.features import KeyLines
from slam.dpl.pose import refine_pose
from slam.dpl.sightings import Sightings, joined, of_line_ends
from slam.geometry import se3
from slam.geometry.camera import project
from slam.types import Intrinsics

CAMERA = Intrinsics(300.0, 310.0, 160.0, 120.0, 320, 240)
TRUE = se3.exp(np.array([0.05, -0.1, 0.02, 0.1, 0.05, -0.1]))
START = np.eye(4)


def world(n, rng):
    xyz = rng.uniform([-1.5, -1.2, 2.0], [1.5, 1.2, 5.0], (n, 3))
    return se3.transform_points(TRUE, xyz)


def seen_points(xyz, rng, sigma):
    local = se3.transform_points(se3.inverse(TRUE), xyz)
    uv = project(CAMERA, local) + rng.normal(scale=sigma, size=(len(xyz), 2))
    whitening = np.tile([1 / max(sigma, 0.1), 0.0, 1 / max(sigma, 0.1), 500.0], (len(xyz), 1))
    return Sightings(uv, whitening, 1.0 / local[:, 2])


def error(T):
    return np.abs(se3.log(se3.inverse(TRUE) @ T)).max()


def test_a_third_of_wrong_points_does_no_harm():
    rng = np.random.default_rng(0)
    xyz = world(300, rng)
    seen = seen_points(xyz, rng, 0.5)
    uv = seen.uv_px.copy()
    uv[:100] += rng.uniform(8, 30, (100, 2))
    fit = refine_pose(START, xyz, Sightings(uv, seen.whitening, seen.rho), CAMERA, 2.5, 30)
    assert error(fit.T_world_camera) < 2e-3
    assert (fit.chi2[:100] > 9).mean() > 0.95
    assert (fit.chi2[100:] < 12).mean() > 0.95


def ends_and_lines(rng, slide):
    """Map lines, seen as segments that cover other parts of them."""
    ends = world(40, rng).reshape(20, 2, 3)
    local = se3.transform_points(se3.inverse(TRUE), ends.reshape(-1, 3)).reshape(20, 2, 3)
    along = local[:, 1] - local[:, 0]
    shown = local + slide * along[:, None]
    return ends, KeyLines(project(CAMERA, shown), np.zeros((20, 32), np.uint8), shown[:, :, 2])


@pytest.mark.parametrize("slide", [0.0, 0.3])
def test_lines_alone_give_the_pose_wherever_their_segments_end(slide):
    ends, lines = ends_and_lines(np.random.default_rng(1), slide)
    T = START
    for _ in range(6):       # the feet of the ends move with the pose
        seen = of_line_ends(ends, lines, T, CAMERA, 0.5, 0.002)
        T = refine_pose(T, ends.reshape(-1, 3), seen, CAMERA, 2.5, 20).T_world_camera
    assert error(T) < 1e-4
    chi2 = refine_pose(T, ends.reshape(-1, 3), seen, CAMERA, 2.5, 20).chi2
    assert chi2.max() < 1e-2


def test_points_and_lines_are_one_family():
    rng = np.random.default_rng(2)
    ends, lines = ends_and_lines(rng, 0.1)
    xyz = world(5, rng)
    both = joined(seen_points(xyz, rng, 0.0), of_line_ends(ends, lines, TRUE, CAMERA, 0.5, 0.002))
    fit = refine_pose(TRUE, np.concatenate([xyz, ends.reshape(-1, 3)]), both, CAMERA, 2.5, 5)
    assert len(fit.chi2) == 45
    assert error(fit.T_world_camera) < 1e-6
