"""Where landmarks are found again."""

import numpy as np
from numpy.testing import assert_allclose

import wave_pictures
from numerics import numerical_jacobian
from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.surface import carried
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.types import Intrinsics

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
