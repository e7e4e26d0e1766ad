"""Segments move across their direction to where the images agree."""

from __future__ import annotations

import numpy as np

from slam.frontend.refine import prepare_image
from slam.frontend.refine_lines import LineRefineConfig, refine_segments

CONFIG = LineRefineConfig()


def polygon(shift, noise=0.0, seed=0, turn=0.0):
    """A soft-edged bright quadrilateral and its corners; its sides are exact off the corners."""
    corners = np.array([[60.0, 40.0], [240.0, 60.0], [220.0, 150.0], [50.0, 140.0]])
    c, s = np.cos(turn), np.sin(turn)
    middle = corners.mean(axis=0)
    corners = (corners - middle) @ np.array([[c, s], [-s, c]]) + middle + shift
    v, u = np.mgrid[:200, :300].astype(float)
    bright = np.ones((200, 300))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        bright *= 0.5 + 0.5 * np.tanh((v - a[1]) * along[0] - (u - a[0]) * along[1])
    noisy = 60 + 120 * bright + noise * np.random.default_rng(seed).normal(size=bright.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), corners


def sides(corners):
    """(4, 2, 2) the polygon's sides, somewhat short of their corners."""
    a, b = corners, np.roll(corners, -1, axis=0)
    return np.stack([0.9 * a + 0.1 * b, 0.1 * a + 0.9 * b], axis=1)


def across(endpoints, line):
    """(N, 2) distances of endpoints (N, 2, 2) from lines (N, 2, 2)."""
    along = line[:, 1] - line[:, 0]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    gap = endpoints - line[:, :1]
    return gap[..., 0] * -along[:, None, 1] + gap[..., 1] * along[:, None, 0]


def refined(noise=0.0, seed=0):
    before, corners = polygon((0.0, 0.0), noise, seed)
    after, moved = polygon((0.7, -0.45), noise, seed + 1000, turn=0.004)
    wrong = sides(moved) + np.array([0.4, 0.3])
    images = [prepare_image(image, CONFIG.patch) for image in (before, after)]
    return refine_segments(*images, sides(corners), wrong, CONFIG), sides(moved), wrong


def test_sides_of_a_polygon_are_found_again():
    found, true, wrong = refined()
    assert found.converged.all()
    assert np.abs(across(found.endpoints_px, true)).max() < 0.03
    assert np.abs(across(wrong, true)).max() > 0.2


def test_nothing_moves_along_the_line():
    found, _, wrong = refined()
    along = wrong[:, 1] - wrong[:, 0]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    slid = np.einsum("nei,ni->ne", found.endpoints_px - wrong, along)
    np.testing.assert_allclose(slid, 0.0, atol=1e-9)


def test_covariance_matches_the_errors():
    squared = []
    for seed in range(12):
        found, true, _ = refined(noise=4.0, seed=seed)
        error = across(found.endpoints_px, true)[found.converged]
        squared.append(np.einsum("ni,nij,nj->n", error,
                                 np.linalg.inv(found.covariance[found.converged]), error))
    assert 0.4 < np.concatenate(squared).mean() / 2.0 < 2.0


def test_a_segment_without_an_edge_stays():
    flat = prepare_image(np.full((100, 100), 80, np.uint8), CONFIG.patch)
    segment = np.array([[[20.0, 30.0], [80.0, 60.0]]])
    found = refine_segments(flat, flat, segment, segment + 0.5)
    assert not found.converged.any()
    np.testing.assert_array_equal(found.endpoints_px, segment + 0.5)


def test_no_segments():
    image = prepare_image(np.zeros((60, 60), np.uint8), CONFIG.patch)
    found = refine_segments(image, image, np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
    assert found.endpoints_px.shape == (0, 2, 2)
