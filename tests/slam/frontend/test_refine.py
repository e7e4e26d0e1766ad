"""Patch alignment finds sub-pixel motion and knows how well."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.support import surface_image
from wave_pictures import lattice, picture


def errors(shift, wrong_by=(0.3, -0.2), previous=None, current=None, **kind):
    previous = picture(**kind) if previous is None else previous
    current = picture(shift=shift, **kind) if current is None else current
    uv = lattice(previous.shape)
    found = refine_matches(prepare_image(previous), prepare_image(current), uv,
                           uv + np.array(shift) + np.array(wrong_by))
    return found, found.uv_current - uv - np.array(shift)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.25, 0.1), (0.5, 0.5), (-1.37, 2.2)])
def test_sub_pixel_shifts_are_found(shift):
    found, error = errors(shift)
    assert found.converged.mean() > 0.98
    assert np.sqrt((error[found.converged] ** 2).sum(-1).mean()) < 0.02
    assert np.abs(error[found.converged].mean(axis=0)).max() < 0.004   # no bias


def test_the_start_leaves_no_trace():
    _, one = errors((0.4, 0.3), wrong_by=(0.3, 0.0))
    _, other = errors((0.4, 0.3), wrong_by=(-0.3, 0.0))
    assert np.abs((one - other).mean(axis=0)).max() < 0.002


def test_brightness_and_contrast_do_not_matter():
    previous = picture()
    current = picture(shift=(0.4, -0.3), gain=0.8, offset=20.0)
    found, error = errors((0.4, -0.3), previous=previous, current=current)
    assert found.converged.mean() > 0.98
    assert np.sqrt((error[found.converged] ** 2).sum(-1).mean()) < 0.02


@pytest.mark.parametrize(("contrast", "noise"), [(50.0, 3.0), (15.0, 1.0), (8.0, 1.5)])
def test_covariance_matches_the_errors(contrast, noise):
    squared = []
    for seed in range(4):
        found, error = errors((0.37, -0.21), seed=seed, contrast=contrast, noise=noise)
        good = found.converged
        squared.append(np.einsum("ni,nij,nj->n", error[good],
                                 np.linalg.inv(found.covariance[good]), error[good]))
    mean = np.concatenate(squared).mean() / 2.0
    assert 0.6 < mean < 1.6


def test_an_edge_moves_across_and_knows_nothing_along():
    def edge(position):
        across = 0.5 + 0.5 * np.tanh(np.arange(120) - position)
        return np.tile(np.rint(60 + 120 * across).astype(np.uint8), (100, 1))
    uv = np.array([[60.0, 50.0]])
    found = refine_matches(prepare_image(edge(60.3)), prepare_image(edge(60.7)), uv,
                           uv + np.array([0.0, 0.6]))
    move = (found.uv_current - uv)[0]
    assert move[0] == pytest.approx(0.4, abs=0.02)
    assert move[1] == pytest.approx(0.6, abs=0.02)        # keeps what it was told
    sigma = np.sqrt(np.diag(found.covariance[0]))
    assert sigma[0] < 0.05
    assert sigma[1] > 0.7 * RefineConfig().prior_sigma_px


def test_a_flat_image_keeps_start_and_prior():
    flat = np.full((80, 80), 90, np.uint8)
    uv = lattice(flat.shape)
    found = refine_matches(prepare_image(flat), prepare_image(flat), uv, uv + 0.4)
    assert not found.converged.any()
    np.testing.assert_array_equal(found.uv_current, uv + 0.4)
    np.testing.assert_allclose(found.covariance, np.tile(np.eye(2), (len(uv), 1, 1)))


def test_no_points_and_points_outside():
    image = prepare_image(picture())
    empty = refine_matches(image, image, np.zeros((0, 2)), np.zeros((0, 2)))
    assert empty.uv_current.shape == (0, 2)
    assert empty.covariance.shape == (0, 2, 2)
    outside = np.array([[-5.0, 10.0], [np.nan, 3.0], [1e9, 1e9], [2.0, 2.0]])
    found = refine_matches(image, image, outside, outside)
    assert not found.converged.any()
    assert np.isinf(found.residual).all()


def test_warps_let_turned_patches_align():
    angle, scale = np.radians(6.0), 1.05
    A = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    # Drawn fine and averaged, so that the oracle's interpolation does not limit the test.
    big = cv2.resize(picture(), (800, 640), interpolation=cv2.INTER_CUBIC)
    previous = cv2.resize(big, (200, 160), interpolation=cv2.INTER_AREA)
    centre = np.array([99.5, 79.5])

    def fine(uv):
        return 4.0 * uv + 1.5
    M = np.column_stack([A, fine(centre) - A @ fine(centre)])
    current = cv2.resize(cv2.warpAffine(big, M, (800, 640), flags=cv2.INTER_CUBIC), (200, 160),
                         interpolation=cv2.INTER_AREA)
    uv = lattice(previous.shape, margin=40)
    true = (uv - centre) @ A.T + centre
    images = prepare_image(previous), prepare_image(current)
    with_warp = refine_matches(*images, uv, true + 0.2, A=np.tile(A, (len(uv), 1, 1)))
    without = refine_matches(*images, uv, true + 0.2)

    def rms(found):
        return np.sqrt(((found.uv_current - true)[found.converged] ** 2).sum(-1).mean())
    assert with_warp.converged.mean() > 0.9
    assert rms(with_warp) < 0.03
    assert rms(with_warp) < 0.5 * rms(without)


def test_a_patch_keeps_to_its_own_surface():
    """Left half near and moving right, right half far and still; points stand by the border."""
    border = 100
    near, far = picture(1), picture(2)
    moved = picture(1, shift=(0.8, 0.0))
    previous, current = far.copy(), far.copy()
    previous[:, :border] = near[:, :border]
    current[:, :border + 1] = moved[:, :border + 1]
    depth = np.where(np.arange(200) < border, 2.0, 5.0) * np.ones((160, 1))
    uv = np.array([[border - 4.0, v] for v in range(20, 140, 3)])
    images = prepare_image(previous), prepare_image(current)
    apart = refine_matches(*images, uv, uv + np.array([0.8, 0.0]), surface=surface_image(depth))
    mixed = refine_matches(*images, uv, uv + np.array([0.8, 0.0]))

    def median(found):
        error = found.uv_current - uv - np.array([0.8, 0.0])
        return np.median(np.linalg.norm(error[found.converged], axis=-1))
    assert apart.converged.mean() > 0.7
    assert median(apart) < 0.03
    assert median(apart) < 0.5 * median(mixed)



def test_each_patch_is_aligned_for_itself():
    """A patch's position does not depend on which others are asked for."""
    previous, current = prepare_image(picture(noise=2.0)), prepare_image(
        picture(shift=(0.3, 0.2), noise=2.0))
    uv = np.tile(lattice((160, 200)), (4, 1))            # more than one block
    every = refine_matches(previous, current, uv, uv)
    some = refine_matches(previous, current, uv[5:50], uv[5:50])
    np.testing.assert_allclose(every.uv_current[5:50], some.uv_current, atol=1e-4)
