"""Cell means of dense flow, against the same sums written out pixel by pixel."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from slam.config import GridConfig, NoiseConfig
from slam.frontend.grid import GRID_KIND, OBJECT_GRID_KIND, grid_matches
from slam.frontend.observe import NO_GROUP
from slam.types import FlowField

SIZE = (37, 50)          # no multiple of a cell
NOISE = NoiseConfig()
CONFIG = GridConfig()


def random_input(seed):
    rng = np.random.default_rng(seed)
    flow = rng.normal(scale=3.0, size=(*SIZE, 2)).astype(np.float32)
    flow[rng.random(SIZE) < 0.05] = np.nan
    flow[rng.random(SIZE) < 0.02] = np.inf
    valid = rng.random(SIZE) < 0.9 if seed % 2 else None
    rho_a = rng.uniform(0.3, 0.36, SIZE).astype(np.float32)
    rho_b = rng.uniform(0.25, 0.44, SIZE).astype(np.float32)
    rho_b[:, 20:] = (0.3 + 0.1 * rho_b[:, 20:]).astype(np.float32)     # one surface
    rho_a[rng.random(SIZE) < 0.1] = 0.0
    rho_b[rng.random(SIZE) < 0.04] = 0.0
    blocks = np.array([0, 0, 0, 1, 2, NO_GROUP], np.uint8)
    group = blocks[np.kron(rng.integers(0, 6, (4, 5)), np.ones((10, 10), int))][:SIZE[0], :SIZE[1]]
    return FlowField(flow, valid), rho_a, rho_b, group, group.copy()


def means_pixel_by_pixel(flow, rho_a, rho_b, group_a, group_b, cell, static):
    """(group, uv, rho_a, uv_b, count, rho_b or None) of each cell with enough pixels."""
    out = []
    for i in range(SIZE[0] // cell):
        for j in range(SIZE[1] // cell):
            own = group_a[i * cell + cell // 2, j * cell + cell // 2]
            if own == NO_GROUP or (own == 0) != static:
                continue
            rows, seen = [], []
            counting = np.zeros(SIZE, bool)
            counting[i * cell:i * cell + cell, j * cell:j * cell + cell] = True
            counting &= (group_a == own) & (rho_a > 0) & np.isfinite(flow.flow_px).all(axis=2)
            if flow.valid is not None:
                counting &= flow.valid
            moves = linear_flow(flow.flow_px, counting)
            for v in range(i * cell, i * cell + cell):
                for u in range(j * cell, j * cell + cell):
                    if not counting[v, u]:
                        continue
                    move = np.array([1.0, u, v]) @ moves
                    to = np.floor(np.array([u, v]) + move + 0.5)
                    if not (0 <= to[0] < SIZE[1] and 0 <= to[1] < SIZE[0]):
                        continue
                    there = int(to[1]), int(to[0])
                    if group_b[there] != own:
                        continue
                    if rho_b[there] > 0:
                        gate = CONFIG.max_depth_change * rho_a[v, u] + 8 * NOISE.inverse_depth_sigma
                        read = between(rho_b, group_b, np.array([u, v]) + move, there)
                        if abs(read - rho_a[v, u]) > gate:
                            continue
                        seen.append(read)
                    rows.append([u, v, *flow.flow_px[v, u].astype(float), rho_a[v, u]])
            if rows and len(rows) >= CONFIG.min_filled * cell**2:
                mean = np.mean(rows, axis=0)
                out.append((own, mean[:2], mean[4], mean[:2] + mean[2:4], len(rows),
                            np.mean(seen) if len(seen) > 0.9 * len(rows) else None))
    return out


def linear_flow(flow_px, counting):
    """(3, 2) of the linear function [1, u, v] @ m nearest to the flow of these pixels; of pixels on
    one line, which tell no plane, their mean."""
    v, u = np.nonzero(counting)
    of = flow_px[counting].astype(float)
    A = np.c_[np.ones(len(u)), u, v]
    if len(u) and np.linalg.matrix_rank(A - A.mean(axis=0)) == 2:
        return np.linalg.lstsq(A, of, rcond=None)[0]
    return np.array([of.mean(axis=0) if len(of) else np.zeros(2), np.zeros(2), np.zeros(2)])


def between(rho, group, uv, nearest):
    """Read between the four pixels around uv if they are one surface of the nearest one's group."""
    corner = np.floor(uv).astype(int)
    if np.any(corner < 0) or corner[0] + 2 > SIZE[1] or corner[1] + 2 > SIZE[0]:
        return rho[nearest]
    four = np.s_[corner[1]:corner[1] + 2, corner[0]:corner[0] + 2]
    if (np.any(group[four] != group[nearest]) or np.any(rho[four] <= 0)
            or np.ptp(rho[four]) > 0.03 * rho[nearest] + 4 * NOISE.inverse_depth_sigma):
        return rho[nearest]
    (x, y) = uv - corner
    return np.array([1 - y, y]) @ rho[four].astype(float) @ np.array([1 - x, x])


@given(st.integers(0, 10_000))
@settings(max_examples=8)
def test_cells_are_the_means_of_their_usable_pixels(seed):
    inputs = random_input(seed)
    found = grid_matches(*inputs, CONFIG, NOISE)
    expected = [(*row, kind) for cell, static, kind in (
        (CONFIG.static_cell_px, True, GRID_KIND),
        (CONFIG.object_cell_px, False, OBJECT_GRID_KIND))
        for row in means_pixel_by_pixel(*inputs, cell, static)]
    assert len(found) == len(expected)
    for n, (group, uv, rho_a, uv_b, count, rho_b, kind) in enumerate(expected):
        assert (found.group[n], found.kind[n]) == (group, kind)
        assert_allclose(found.uv_a[n], uv, atol=1e-9)
        assert_allclose(found.uv_b[n], uv_b, atol=1e-5)
        assert_allclose(found.rho_a[n], freed(rho_a), rtol=1e-6)
        assert_allclose(found.flow_cov[n], NOISE.flow_sigma_px**2 / count * np.eye(2))
        assert_allclose(found.rho_sigma_a[n], NOISE.inverse_depth_sigma / np.sqrt(count))
        if rho_b is None:
            assert np.isinf(found.rho_sigma_b[n])
        else:
            assert_allclose(found.rho_b[n], freed(rho_b), rtol=1e-6)
            assert_allclose(found.rho_sigma_b[n], found.rho_sigma_a[n])


def freed(rho):
    """Of what Gaussian noise of z adds to the mean of 1/z."""
    return rho - min(NOISE.inverse_depth_sigma**2 / rho, 0.2 * rho)


def test_noise_of_the_depth_leaves_no_bias():
    z_m = 30.0
    rng = np.random.default_rng(1)
    flow, _, _, group_a, group_b = uniform()
    seen = z_m + NOISE.inverse_depth_sigma * z_m**2 * rng.normal(size=(2, *SIZE))
    found = grid_matches(flow, *(1.0 / seen).astype(np.float32), group_a, group_b, CONFIG, NOISE)
    error = np.mean(found.rho_a) * z_m - 1.0
    assert abs(error) < 4 * NOISE.inverse_depth_sigma * z_m / np.sqrt(seen[0].size)


def uniform(flow=(0.0, 0.0), group=0):
    return (FlowField(np.broadcast_to(np.array(flow, np.float32), (*SIZE, 2))),
            np.full(SIZE, 0.5, np.float32), np.full(SIZE, 0.5, np.float32),
            np.full(SIZE, group, np.uint8), np.full(SIZE, group, np.uint8))


@pytest.mark.parametrize(("group", "cells"), [(0, 4 * 6), (3, 9 * 12), (NO_GROUP, 0)])
def test_every_whole_cell_of_a_clean_image_counts(group, cells):
    found = grid_matches(*uniform(group=group), CONFIG, NOISE)
    assert len(found) == cells
    assert_array_equal(found.group, group)


def test_pixels_that_leave_their_object_do_not_count():
    flow, rho_a, rho_b, group_a, group_b = uniform(group=1)
    assert len(grid_matches(flow, rho_a, rho_b, group_a, np.zeros_like(group_b), CONFIG,
                            NOISE)) == 0


def test_a_depth_that_no_motion_explains_does_not_count():
    flow, rho_a, rho_b, group_a, group_b = uniform()
    found = grid_matches(flow, rho_a, rho_b * np.float32(1.3), group_a, group_b, CONFIG, NOISE)
    assert len(found) == 0


def test_flow_that_is_all_unknown_gives_no_matches():
    rest = uniform()[1:]
    for flow in (FlowField(np.full((*SIZE, 2), np.nan, np.float32)),
                 FlowField(np.zeros((*SIZE, 2), np.float32), np.zeros(SIZE, bool)),
                 FlowField(np.full((*SIZE, 2), 1e9, np.float32))):
        assert len(grid_matches(flow, *rest, CONFIG, NOISE)) == 0


def test_the_mean_of_noisy_flow_is_as_good_as_it_says():
    rng = np.random.default_rng(1)
    flow, *rest = uniform((0.3, -0.2))
    noise = replace(NOISE, flow_sigma_px=0.5)
    square = []
    for _ in range(30):
        noisy = FlowField(flow.flow_px + 0.5 * rng.normal(size=(*SIZE, 2)).astype(np.float32))
        found = grid_matches(noisy, *rest, CONFIG, noise)
        inner = (found.uv_a > 8).all(axis=1) & (found.uv_a < [40, 28]).all(axis=1)
        error = (found.uv_b - found.uv_a - [0.3, -0.2])[inner]
        square.append(error**2 / found.flow_cov[inner][:, [0, 1], [0, 1]])
    assert np.mean(np.concatenate(square)) == pytest.approx(1.0, rel=0.1)


def test_depth_between_pixels_is_that_of_the_plane():
    """The nearest pixel's would err by half a slope, alike in every cell."""
    flow, rho, _, group_a, group_b = uniform(flow=(0.5, -0.3), group=2)
    plane = (0.5 + 0.002 * np.arange(SIZE[1]) + 0.001 * np.arange(SIZE[0])[:, None])
    found = grid_matches(flow, rho, plane.astype(np.float32), group_a, group_b, CONFIG, NOISE, 0.0)
    inside = (found.uv_b > 0).all(axis=1) & (found.uv_b < np.array(SIZE)[::-1] - 8).all(axis=1)
    expected = 0.5 + 0.002 * found.uv_b[:, 0] + 0.001 * found.uv_b[:, 1]
    inside &= found.uv_b[:, 1] > 8          # the topmost cells lose their first row
    assert inside.sum() > 10
    assert_allclose(found.rho_b[inside], expected[inside], atol=1e-6)


def test_noise_of_the_flow_at_a_border_leaves_no_bias():
    """Pixels of a wall that slides behind a still pillar: by its own noise, one beside the border
    would count only where that leads away from it."""
    rng = np.random.default_rng(2)
    size, true = (480, 64), np.array([2.5, 0.0])
    group_a, group_b = np.zeros((2, *size), np.uint8)
    group_a[:, 40:], group_b[:, 40:] = 1, 1
    rho = np.full(size, 0.5, np.float32)
    errors = []
    for _ in range(20):
        noise = 0.5 * rng.normal(size=(*size, 2))
        found = grid_matches(FlowField((true + noise).astype(np.float32)), rho, rho, group_a,
                             group_b, CONFIG, NOISE)
        still = found.group == 0
        errors.append((found.uv_b - found.uv_a)[still] - true)
    error = np.concatenate(errors)
    assert np.abs(error.mean(axis=0)).max() < 4 * 0.5 / np.sqrt(60 * len(error))


def test_the_slope_of_a_cell_is_that_of_its_plane():
    v, u = np.mgrid[:SIZE[0], :SIZE[1]]
    flow, _, _, group_a, group_b = uniform(flow=(0.3, 0.4))
    plane = (0.4 + 0.002 * u - 0.001 * v).astype(np.float32)
    found = grid_matches(flow, plane, plane, group_a, group_b, CONFIG, NOISE, 0.0)
    assert_allclose(found.rho_slope_b, np.tile([0.002, -0.001], (len(found), 1)), atol=1e-6)
