"""Where landmarks are found again."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

import box_world as bw
import wave_pictures
from numerics import numerical_jacobian
from slam.backend.anchors import PointAnchors
from slam.backend.config import AnchorConfig
from slam.backend.frame_bodies import frame_bodies
from slam.backend.line_anchors import LineAnchors
from slam.config import NoiseConfig
from slam.frontend.observe import observe
from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.segments import cull_segments, detect_segments
from slam.frontend.surface import carried
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.map import STATIC, MapRecord
from slam.types import Intrinsics, Segments2D

CAMERA = Intrinsics(500.0, 520.0, 319.5, 239.5, 640, 480)


def test_carried_is_projection_and_its_warp_the_derivative_on_the_surface():
    rng = np.random.default_rng(0)
    uv, rho = rng.uniform([100, 100], [500, 400], (5, 2)), rng.uniform(0.1, 0.5, 5)
    slope = rng.normal(size=(5, 2)) * 1e-3
    T = se3.exp(rng.normal(size=(5, 6)) * 0.1)

    def at(offset):
        rho_there = rho + slope @ offset
        p = pinhole.back_project(CAMERA, uv + offset, 1.0 / rho_there)
        moved = np.einsum("nij,nj->ni", T[:, :3, :3], p) + T[:, :3, 3]
        return np.concatenate([pinhole.project(CAMERA, moved), 1.0 / moved[:, 2:]], axis=1)

    uv_b, rho_b, warp = carried(CAMERA, uv, rho, slope, T)
    assert_allclose(np.concatenate([uv_b, rho_b[:, None]], axis=1), at(np.zeros(2)), rtol=1e-9)
    assert_allclose(warp, numerical_jacobian(lambda d: at(d)[:, :2], 2, 1e-3), atol=1e-6)


def test_a_landmark_behind_the_camera_says_so():
    turn = se3.exp(np.array([[0.0, np.pi, 0.0, 0.0, 0.0, 0.0]]))
    uv, rho, _ = carried(CAMERA, np.array([[320.0, 240.0]]), np.array([0.2]), np.zeros((1, 2)),
                         turn)
    assert rho[0] < 0
    assert np.isfinite(uv).all()


def followed(spoilt, sought=(0,)):
    """Numbers of the points and lines that each frame of a still scene shows, by ray casting.

    Args:
        spoilt: frames whose picture is noise; sought: frames in which new landmarks are sought.
    """
    camera = bw.hand_held(9, 0.3)
    frames = bw.sequence(camera, {5: bw.Box((0.7, 0.5, 0.4), bw.standing(0.1, 0.2, -0.6, 9))})
    config = AnchorConfig(misses=3)
    record = MapRecord()
    points = PointAnchors(bw.CAMERA, config, NoiseConfig(), record.points)
    lines = LineAnchors(bw.CAMERA, config, NoiseConfig(), record.lines)
    rng, seen = np.random.default_rng(0), []
    for k, frame in enumerate(frames):
        noise = rng.integers(0, 256, frame.rgb.shape, dtype=np.uint8)
        current = observe(replace(frame, rgb=noise) if k in spoilt else frame)
        now = frame_bodies(k, current, prepare_image(current.gray), {STATIC: camera[k]},
                           {5: STATIC}, [STATIC])
        points.follow(now)
        lines.follow(now)
        if k in sought:
            ends = detect_segments(current.gray)
            kept, _, depth = cull_segments(ends, frame.depth_m, now.groups)
            none = np.zeros(kept.sum(), np.int64)
            points.detect(now)
            lines.detect(now, Segments2D(ends[kept], depth[kept], none, none.astype(np.int32)))
        seen.append([sorted({int(n) for o in record_of.observations_of(k) for n in o.landmark})
                     for record_of in (record.points, record.lines)])
    return seen


def test_landmarks_that_are_lost_for_a_while_are_found_as_the_same():
    whole, gap = followed(spoilt=()), followed(spoilt=(3, 4, 5))
    for kind in (0, 1):
        first = set(gap[0][kind])
        assert len(first) > (20, 3)[kind]
        assert not any(gap[k][kind] for k in (3, 4, 5))
        again = set(gap[6][kind])
        assert again <= first
        assert len(again) > 0.9 * len(set(whole[6][kind]))
        assert len(again) > 0.5 * len(first)


def test_landmarks_that_are_lost_for_longer_end_and_others_take_their_place():
    seen = followed(spoilt=(3, 4, 5, 6), sought=(0, 7))
    for kind in (0, 1):
        assert seen[2][kind]
        assert seen[7][kind]
        assert not set(seen[7][kind]) & set(seen[0][kind])
        assert set(seen[8][kind]) <= set(seen[7][kind])
        assert seen[8][kind]


def test_alignment_without_ramps_does_not_follow_the_light():
    """A lamp that moves makes one side of each patch brighter: no shift, but it looks like one."""
    before = wave_pictures.picture(shift=(0.0, 0.0))
    after = wave_pictures.picture(shift=(0.3, -0.2)).astype(np.float64)
    v, u = np.mgrid[:before.shape[0], :before.shape[1]]
    # Steep waves of light, far longer than a patch.
    lit = after + 25.0 * np.sin(u / 14.0) + 25.0 * np.sin(v / 14.0)
    at = wave_pictures.lattice(before.shape)
    errors = []
    for blind in (False, True):
        config = RefineConfig(without_ramps=blind)
        got = refine_matches(prepare_image(before, config), prepare_image(
            np.clip(lit, 0, 255).astype(np.float32), config), at, at, config)
        e = (got.uv_current - at - [0.3, -0.2])[got.converged]
        errors.append(np.sqrt(np.mean(e**2)))
    assert errors[1] < 0.6 * errors[0]
