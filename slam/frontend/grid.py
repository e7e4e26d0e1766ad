"""Dense flow as a grid of point correspondences: each is the mean over one cell of the image.

A given flow field has noise of its own at each pixel. The flow, the inverse depth and the pixel
of a rigid surface are, over a few pixels, linear in each other, so that their means over a cell
obey the same equations with the noise divided by the root of the number of pixels.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.config import GridConfig, NoiseConfig
from slam.geometry.arrays import Array
from slam.matches import PointMatches, join
from slam.types import FlowField

GRID_KIND = 0      # PointMatches.kind of cells on the static world
OBJECT_GRID_KIND = 1   # of the smaller cells on objects
_STEEPEST = 0.03       # relative slope per pixel of a surface seen at a grazing angle


def grid_matches(flow: FlowField, rho_a: Array, rho_b: Array, group_a: Array, group_b: Array,
                 config: GridConfig, noise: NoiseConfig, depth_scale: float = 1.0) -> PointMatches:
    """Cell means of a dense flow field as point matches.

    Noise of z, σ_z = σ z², makes 1/z too large in the mean, by σ²/ρ; the means are freed of it.

    Args:
        flow: from a to b on a's pixels.
        rho_a, rho_b: (H, W) float32 inverse depths, 0 where unknown.
        group_a, group_b: (H, W) uint8 motion group of each pixel in its own frame, 0 = static,
            255 = to be left out. A pixel counts if it stays in its group.
        depth_scale: measured over assumed standard deviation of the depth.
    """
    valid = np.zeros((0, 0), np.bool_) if flow.valid is None else flow.valid
    arguments = (np.ascontiguousarray(flow.flow_px, dtype=np.float32), valid, rho_a, rho_b,
                 group_a, group_b, config.max_depth_change, 8.0 * noise.inverse_depth_sigma,
                 4.0 * depth_scale * noise.inverse_depth_sigma)
    static, _ = _cell_sums(config.static_cell_px, True, *arguments)
    objects, group = _cell_sums(config.object_cell_px, False, *arguments)
    variance = (depth_scale * noise.inverse_depth_sigma) ** 2
    return join(_matches(static, np.zeros(len(static), np.int64), config.static_cell_px, GRID_KIND,
                         config, noise, variance),
                _matches(objects, group, config.object_cell_px, OBJECT_GRID_KIND, config, noise,
                         variance))


@numba.njit(cache=True, nogil=True)
def _cell_sums(cell_px: int, static: bool, flow: Array, valid: Array, rho_a: Array, rho_b: Array,
               group_a: Array, group_b: Array, max_change: float,
               max_noise: float, noise: float) -> tuple[Array, Array]:
    """Sums over the usable pixels of each cell, and each cell's group.

    A cell belongs to the group of its middle pixel; cells of the static world, or all others.

    Returns:
        (C, 10): count, Σu, Σv, Σ flow u, Σ flow v, Σρ_a, count with depth in b, Σρ_b, Σ ∂ρ_b/∂u,
        Σ ∂ρ_b/∂v; (C,).
    """
    height, width = rho_a.shape
    rows, columns = height // cell_px, width // cell_px
    sums = np.zeros((rows * columns, 10))
    group = np.zeros(rows * columns, np.int64)
    used = 0
    for i in range(rows):
        for j in range(columns):
            own = group_a[i * cell_px + cell_px // 2, j * cell_px + cell_px // 2]
            if own == 255 or (own == 0) != static:
                continue
            count = count_b = sum_u = sum_v = flow_u = flow_v = sum_a = sum_b = 0.0
            slope_u = slope_v = 0.0
            for v in range(i * cell_px, (i + 1) * cell_px):
                for u in range(j * cell_px, (j + 1) * cell_px):
                    here = rho_a[v, u]
                    if group_a[v, u] != own or here <= 0.0:
                        continue
                    if valid.size > 0 and not valid[v, u]:
                        continue
                    du, dv = flow[v, u, 0], flow[v, u, 1]
                    there_u, there_v = u + du, v + dv
                    if not (-0.5 <= there_u < width - 0.5 and -0.5 <= there_v < height - 0.5):
                        continue
                    to_u, to_v = int(there_u + 0.5), int(there_v + 0.5)
                    if group_b[to_v, to_u] != own:
                        continue
                    seen, along_u, along_v = _between_pixels(
                        rho_b, group_b, there_u, there_v, rho_b[to_v, to_u], noise)
                    if seen > 0.0:
                        # Wide enough for the noise: a gate that cuts its tail biases the mean.
                        if abs(seen - here) > max_change * here + max_noise:
                            continue
                        count_b += 1.0
                        sum_b += seen
                        slope_u += along_u
                        slope_v += along_v
                    count += 1.0
                    sum_u += u
                    sum_v += v
                    flow_u += du
                    flow_v += dv
                    sum_a += here
            if count > 0.0:
                sums[used, :5] = count, sum_u, sum_v, flow_u, flow_v
                sums[used, 5:] = sum_a, count_b, sum_b, slope_u, slope_v
                group[used] = own
                used += 1
    return sums[:used], group[:used]


@numba.njit(cache=True, nogil=True, inline="always")
def _between_pixels(rho, group, u, v, nearest, noise):  # type: ignore[no-untyped-def]
    """Inverse depth at (u, v) between four pixels of one surface, and its slopes; else that of the
    nearest, which has none.

    Reading the nearest errs alike all over a surface whose flow is nearly the same everywhere, by
    up to half a pixel's slope: an error along the ray that no number of pixels averages out.

    Args:
        noise: pixels that differ by more, and 3 % of their inverse depth, lie on two surfaces.
    """
    left, top = int(np.floor(u)), int(np.floor(v))
    if left < 0 or top < 0 or left + 1 >= rho.shape[1] or top + 1 >= rho.shape[0]:
        return nearest, 0.0, 0.0
    own, total, least, most = group[top, left], 0.0, nearest, nearest
    across, down = u - left, v - top
    for i in range(2):
        of_row = down if i == 1 else 1.0 - down
        for j in range(2):
            here = rho[top + i, left + j]
            if here <= 0.0 or group[top + i, left + j] != own:
                return nearest, 0.0, 0.0
            least, most = min(least, here), max(most, here)
            total += here * of_row * (across if j == 1 else 1.0 - across)
    if most - least > _STEEPEST * nearest + noise:
        return nearest, 0.0, 0.0
    upper, lower = rho[top, left + 1] - rho[top, left], rho[top + 1, left + 1] - rho[top + 1, left]
    return (total, upper + down * (lower - upper),
            rho[top + 1, left] - rho[top, left] + across * (lower - upper))


def _matches(sums: Array, group: Array, cell_px: int, kind: int, config: GridConfig,
             noise: NoiseConfig, rho_variance: float) -> PointMatches:
    keep = sums[:, 0] >= config.min_filled * cell_px**2
    sums, group = sums[keep], group[keep]
    n = sums[:, 0]
    mean = sums[:, 1:6] / n[:, None]
    # Depth in b must be of nearly all the pixels, or its mean is of another place.
    known_b = sums[:, 6] > 0.9 * n
    mean_b = np.where(known_b[:, None], sums[:, 7:10] / np.maximum(sums[:, 6:7], 1.0), 0.0)
    sigma_rho = noise.inverse_depth_sigma / np.sqrt(n)
    rho_a = _without_bias(mean[:, 4], rho_variance)
    variance = noise.flow_sigma_px**2 / n
    uv = mean[:, 0:2]
    return PointMatches(
        uv_a=uv, rho_a=rho_a, rho_sigma_a=sigma_rho, uv_b=uv + mean[:, 2:4],
        flow_cov=variance[:, None, None] * np.eye(2),
        rho_b=_without_bias(mean_b[:, 0], rho_variance),
        rho_sigma_b=np.where(known_b, sigma_rho, np.inf), rho_slope_b=mean_b[:, 1:],
        group=group, kind=np.full(len(n), kind))


def _without_bias(rho: Array, variance: float) -> Array:
    """Mean inverse depths less σ²/ρ, by a fifth at most."""
    return np.asarray(rho - np.minimum(variance / np.maximum(rho, 1e-9), 0.2 * rho))
