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
from slam.matches import PointMatches
from slam.tables import joined
from slam.types import FlowField

GRID_KIND = 0      # PointMatches.kind of cells on the static world
OBJECT_GRID_KIND = 1   # of the smaller cells on objects
_FARTHEST_PX = 1e4     # no flow; nor is what is not a number
_STEEPEST = 0.03       # relative slope per pixel of a surface seen at a grazing angle


def grid_matches(flow: FlowField, rho_a: Array, rho_b: Array, group_a: Array, group_b: Array,
                 config: GridConfig, noise: NoiseConfig, depth_scale: float = 1.0,
                 static_rows: int = 1, noisy_pixels: bool = True) -> PointMatches:
    """Cell means of a dense flow field as point matches.

    Noise of z, σ_z = σ z², makes 1/z too large in the mean, by σ²/ρ; the means are freed of it.

    Args:
        flow: from a to b on a's pixels.
        rho_a, rho_b: (H, W) float32 inverse depths, 0 where unknown.
        group_a, group_b: (H, W) uint8 motion group of each pixel in its own frame, 0 = static,
            255 = to be left out. A pixel counts if it stays in its group.
        depth_scale: measured over assumed standard deviation of the depth.
        static_rows: of the static world every so many rows of pixels count.
        noisy_pixels: each vector has noise of its own, as given flow has: where a pixel comes to
            lie is then told by its whole cell, and slopes are fitted.
    """
    valid = np.zeros((0, 0), np.bool_) if flow.valid is None else flow.valid
    arguments = (np.ascontiguousarray(flow.flow_px, dtype=np.float32), valid, rho_a, rho_b,
                 group_a, group_b, config.max_depth_change, 8.0 * noise.inverse_depth_sigma,
                 4.0 * depth_scale * noise.inverse_depth_sigma, noisy_pixels)
    static, _ = _cell_sums(config.static_cell_px, static_rows, True, *arguments)
    objects, group = _cell_sums(config.object_cell_px, 1, False, *arguments)
    variance = (depth_scale * noise.inverse_depth_sigma) ** 2
    pixels = config.static_cell_px * -(-config.static_cell_px // static_rows)
    return joined(_matches(static, np.zeros(len(static), np.int64), pixels, GRID_KIND, config,
                           noise, variance),
                  _matches(objects, group, config.object_cell_px**2, OBJECT_GRID_KIND, config,
                           noise, variance))


@numba.njit(cache=True, nogil=True)
def _cell_sums(cell_px: int, every: int, static: bool, flow: Array, valid: Array, rho_a: Array,
               rho_b: Array, group_a: Array, group_b: Array, max_change: float,
               max_noise: float, noise: float, noisy_pixels: bool) -> tuple[Array, Array]:
    """Sums over the usable pixels of each cell, and each cell's group.

    A cell belongs to the group of its middle pixel; cells of the static world, or all others.

    Returns:
        (C, 10): count, Σu, Σv, Σ flow u, Σ flow v, Σρ_a, count with depth in b, Σρ_b, and the
        slopes ∂ρ_b/∂u, ∂ρ_b/∂v; (C,).
    """
    rows, columns = rho_a.shape[0] // cell_px, rho_a.shape[1] // cell_px
    sums = np.zeros((rows * columns, 10))
    group = np.zeros(rows * columns, np.int64)
    used = 0
    for i in range(rows):
        for j in range(columns):
            own = group_a[i * cell_px + cell_px // 2, j * cell_px + cell_px // 2]
            if own == 255 or (own == 0) != static:
                continue
            _add_cell(sums[used], i * cell_px, j * cell_px, cell_px, every, own, flow, valid, rho_a,
                      rho_b, group_a, group_b, max_change, max_noise, noise, noisy_pixels)
            if sums[used, 0] > 0.0:
                group[used] = own
                used += 1
    return sums[:used], group[:used]


# Numbers only: each array handed to a function, inlined or not, is counted in every pixel, which
# takes three times as long as all the rest.
@numba.njit(cache=True, nogil=True, inline="always")
def _counts(own, rho, valid, flow_u, flow_v):  # type: ignore[no-untyped-def]
    """Whether a pixel has all that it needs in its own frame."""
    return (own and rho > 0.0 and valid and abs(flow_u) < _FARTHEST_PX
            and abs(flow_v) < _FARTHEST_PX)


@numba.njit(cache=True, nogil=True)
def _flow_of_cell(top, left, cell_px, every, own, flow, valid, rho_a,  # type: ignore[no-untyped-def]
                  group_a, model):
    """The flow of a cell as a linear function of the pixel, by least squares.

    Fills model (2, 3): for u and v the flow at the cell's corner, and its slopes across and down.

    Returns:
        how many pixels count in their own frame.
    """
    n = p_sum = q_sum = pp = pq = qq = 0.0
    moments = np.zeros((2, 3))                   # Σ flow, Σ p flow, Σ q flow
    every_valid = valid.size == 0
    for v in range(top, top + cell_px, every):
        for u in range(left, left + cell_px):
            if not _counts(group_a[v, u] == own, rho_a[v, u], every_valid or valid[v, u],
                           flow[v, u, 0], flow[v, u, 1]):
                continue
            p, q = u - left, v - top
            n, p_sum, q_sum = n + 1.0, p_sum + p, q_sum + q
            pp, pq, qq = pp + p * p, pq + p * q, qq + q * q
            for axis in range(2):
                moments[axis, 0] += flow[v, u, axis]
                moments[axis, 1] += p * flow[v, u, axis]
                moments[axis, 2] += q * flow[v, u, axis]
    if n == 0.0:
        return n
    for axis in range(2):
        across, down = _slopes(n, p_sum, q_sum, pp, pq, qq, moments[axis])
        model[axis, 0] = (moments[axis, 0] - across * p_sum - down * q_sum) / n
        model[axis, 1], model[axis, 2] = across, down
    return n


@numba.njit(cache=True, nogil=True, inline="always")
def _slopes(n, p_sum, q_sum, pp, pq, qq, moments):  # type: ignore[no-untyped-def]
    """Slopes across and down of values f at pixels (p, q), from Σf, Σpf, Σqf; 0 if undetermined."""
    pp, pq, qq = pp - p_sum * p_sum / n, pq - p_sum * q_sum / n, qq - q_sum * q_sum / n
    pf, qf = moments[1] - p_sum * moments[0] / n, moments[2] - q_sum * moments[0] / n
    det = pp * qq - pq * pq
    if det <= 1e-6 * pp * qq:
        return 0.0, 0.0
    return (qq * pf - pq * qf) / det, (pp * qf - pq * pf) / det


@numba.njit(cache=True, nogil=True)
def _add_cell(sums, top, left, cell_px, every, own, flow, valid, rho_a,  # type: ignore[no-untyped-def]
              rho_b, group_a, group_b, max_change, max_noise, noise, noisy_pixels):
    """Fill the sums of one cell.

    Where noisy pixels come to lie is told by the flow of their whole cell. By its own, those beside
    a border would count as their noise leads away from it, and what is left errs to one side.
    Estimated flow has no such noise: it keeps each pixel's own place and slope.
    """
    model = np.zeros((2, 3))
    if noisy_pixels and _flow_of_cell(top, left, cell_px, every, own, flow, valid, rho_a, group_a,
                                      model) == 0.0:
        return
    height, width = rho_a.shape
    every_valid = valid.size == 0
    count = count_b = sum_u = sum_v = flow_u = flow_v = sum_a = sum_b = slope_u = slope_v = 0.0
    p_sum = q_sum = pp = pq = qq = 0.0           # of the pixels with depth in b
    moments = np.zeros(3)
    for v in range(top, top + cell_px, every):
        for u in range(left, left + cell_px):
            here, p, q = rho_a[v, u], u - left, v - top
            if not _counts(group_a[v, u] == own, here, every_valid or valid[v, u],
                           flow[v, u, 0], flow[v, u, 1]):
                continue
            # Where it comes to lie: by its cell's flow there, or by its own.
            x = (u + model[0, 0] + p * model[0, 1] + q * model[0, 2] if noisy_pixels
                 else u + flow[v, u, 0])
            y = (v + model[1, 0] + p * model[1, 1] + q * model[1, 2] if noisy_pixels
                 else v + flow[v, u, 1])
            if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
                continue
            near = int(y + 0.5), int(x + 0.5)
            if group_b[near] != own:
                continue
            seen, along_u, along_v = rho_b[near], 0.0, 0.0
            i, j = int(np.floor(y)), int(np.floor(x))
            if (0 <= i < height - 1 and 0 <= j < width - 1 and group_b[i, j] == own
                    and group_b[i, j + 1] == own and group_b[i + 1, j] == own
                    and group_b[i + 1, j + 1] == own):
                seen, along_u, along_v = _between(
                    rho_b[i, j], rho_b[i, j + 1], rho_b[i + 1, j], rho_b[i + 1, j + 1],
                    x - j, y - i, seen, _STEEPEST * seen + noise)
            if seen > 0.0:
                # Wide enough for the noise: a gate that cuts its tail biases the mean.
                if abs(seen - here) > max_change * here + max_noise:
                    continue
                count_b += 1.0
                sum_b += seen
                slope_u += along_u
                slope_v += along_v
                p_sum, q_sum = p_sum + p, q_sum + q
                pp, pq, qq = pp + p * p, pq + p * q, qq + q * q
                moments[1] += p * seen
                moments[2] += q * seen
            count += 1.0
            sum_u += u
            sum_v += v
            flow_u += flow[v, u, 0]
            flow_v += flow[v, u, 1]
            sum_a += here
    sums[:5] = count, sum_u, sum_v, flow_u, flow_v
    sums[5:8] = sum_a, count_b, sum_b
    if count_b > 0.0:
        sums[8], sums[9] = slope_u / count_b, slope_v / count_b
    if noisy_pixels and count_b > 0.0:
        # By least squares: such a slope and the mean have no noise in common. Of the differences
        # between the pixels that each depth is read between they do, and weighed by each other
        # they bias the motion, the more so the noisier the flow.
        moments[0] = sum_b
        sums[8], sums[9] = _slopes(count_b, p_sum, q_sum, pp, pq, qq, moments)


@numba.njit(cache=True, nogil=True, inline="always")
def _between(a, b, c, d, across, down, nearest, limit):  # type: ignore[no-untyped-def]
    """Inverse depth between four pixels of one surface, a b above c d, and its slopes; else that of
    the nearest, which has none.

    Reading the nearest errs alike all over a surface whose flow is nearly the same everywhere, by
    up to half a pixel's slope: an error along the ray that no number of pixels averages out.

    Args:
        limit: pixels that differ by more lie on two surfaces.
    """
    least, most = min(a, b, c, d), max(a, b, c, d)
    if least <= 0.0 or most - least > limit:
        return nearest, 0.0, 0.0
    upper, lower, left = b - a, d - c, c - a
    turn = lower - upper
    return (a + across * upper + down * (left + across * turn), upper + down * turn,
            left + across * turn)


def _matches(sums: Array, group: Array, pixels: int, kind: int, config: GridConfig,
             noise: NoiseConfig, rho_variance: float) -> PointMatches:
    keep = sums[:, 0] >= config.min_filled * pixels
    sums, group = sums[keep], group[keep]
    n = sums[:, 0]
    mean = sums[:, 1:6] / n[:, None]
    # Depth in b must be of nearly all the pixels, or its mean is of another place.
    known_b = sums[:, 6] > 0.9 * n
    mean_b = np.where(known_b, sums[:, 7] / np.maximum(sums[:, 6], 1.0), 0.0)
    sigma_rho = noise.inverse_depth_sigma / np.sqrt(n)
    rho_a = _without_bias(mean[:, 4], rho_variance)
    variance = noise.flow_sigma_px**2 / n
    uv = mean[:, 0:2]
    return PointMatches(
        uv_a=uv, rho_a=rho_a, rho_sigma_a=sigma_rho, uv_b=uv + mean[:, 2:4],
        flow_cov=variance[:, None, None] * np.eye(2),
        rho_b=_without_bias(mean_b, rho_variance),
        rho_sigma_b=np.where(known_b, sigma_rho, np.inf),
        rho_slope_b=np.where(known_b[:, None], sums[:, 8:], 0.0),
        group=group, kind=np.full(len(n), kind))


def _without_bias(rho: Array, variance: float) -> Array:
    """Mean inverse depths less σ²/ρ, by a fifth at most."""
    return np.asarray(rho - np.minimum(variance / np.maximum(rho, 1e-9), 0.2 * rho))
