"""Matching of binary descriptors: around predictions, and everything with everything."""

from __future__ import annotations

import numba
import numpy as np

from slam.geometry.arrays import Array

_BITS = np.array([bin(i).count("1") for i in range(256)], dtype=np.uint8)


@numba.njit(cache=True, inline="always")
def _popcount(x):  # type: ignore[no-untyped-def]
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@numba.njit(cache=True, inline="always")
def hamming(a, b):  # type: ignore[no-untyped-def]
    total = np.uint64(0)
    for k in range(4):
        total += _popcount(a[k] ^ b[k])
    return np.int64(total)


def as_words(descriptor: Array) -> Array:
    """(N, 4) uint64 of descriptors (N, 32) uint8."""
    return np.ascontiguousarray(descriptor).view(np.uint64).reshape(-1, 4)


def match_near(uv_expected: Array, words: Array, radius_px: Array, level: Array, uv: Array,
               words_seen: Array, level_seen: Array, max_distance: int, ratio: float,
               cell_px: float = 16.0) -> Array:
    """For each expected point the seen one that looks most like it nearby, or −1.

    A seen point serves the one expected point that it resembles most.

    Args:
        uv_expected: (N, 2), NaN where not in view.
        words: (N, 4) uint64.
        radius_px: (N,) where to look.
        level: (N,) pyramid level at which each is expected; the seen one's may differ by one.
        uv, words_seen, level_seen: (M, 2), (M, 4), (M,) of the seen points.
        ratio: the best must be nearer than this share of the second best of the same level.
    Returns:
        (N,) int64 rows of the seen points.
    """
    match = np.full(len(uv_expected), -1, dtype=np.int64)
    if len(uv) == 0 or len(uv_expected) == 0:
        return match
    width = int(max(uv[:, 0].max(), 1.0) / cell_px) + 1
    height = int(max(uv[:, 1].max(), 1.0) / cell_px) + 1
    column = np.clip((uv[:, 0] / cell_px).astype(np.int64), 0, width - 1)
    row = np.clip((uv[:, 1] / cell_px).astype(np.int64), 0, height - 1)
    cell = row * width + column
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(width * height + 1))
    _match_near(uv_expected, words, radius_px, level, uv, words_seen, level_seen,
                max_distance, ratio, order, start, width, height, cell_px, match)
    return match


@numba.njit(cache=True)
def _match_near(expected, words, radius, level, uv, seen, level_seen,  # type: ignore[no-untyped-def]
                max_distance, ratio, order, start, width, height, cell, match):
    owner = np.full(len(uv), -1, np.int64)
    owned = np.full(len(uv), 1 << 30, np.int64)
    for i in range(len(expected)):
        u, v, r = expected[i, 0], expected[i, 1], radius[i]
        if not (u + r >= 0.0 and v + r >= 0.0 and u - r < width * cell and v - r < height * cell):
            continue
        c0, c1 = max(int((u - r) / cell), 0), min(int((u + r) / cell), width - 1)
        r0, r1 = max(int((v - r) / cell), 0), min(int((v + r) / cell), height - 1)
        best, second, which = 1 << 30, 1 << 30, -1
        for y in range(r0, r1 + 1):
            for k in range(start[y * width + c0], start[y * width + c1 + 1]):
                j = order[k]
                if abs(level_seen[j] - level[i]) > 1:
                    continue
                du, dv = uv[j, 0] - u, uv[j, 1] - v
                if du * du + dv * dv > r * r:
                    continue
                d = hamming(words[i], seen[j])
                if d < best:
                    if which < 0 or level_seen[which] == level_seen[j]:
                        second = best
                    best, which = d, j
                elif d < second and level_seen[which] == level_seen[j]:
                    second = d
        if which < 0 or best > max_distance or best > ratio * second:
            continue
        if best < owned[which]:
            if owner[which] >= 0:
                match[owner[which]] = -1
            owner[which], owned[which] = i, best
            match[i] = which


def match_all(words_a: Array, words_b: Array, max_distance: int, ratio: float) -> Array:
    """Nearest of b for each of a, both ways and clearly: (N,) rows of b, or −1."""
    if len(words_a) == 0 or len(words_b) < 2:
        return np.full(len(words_a), -1, dtype=np.int64)
    return np.asarray(_match_all(words_a, words_b, max_distance, ratio))


@numba.njit(cache=True)
def _match_all(a, b, max_distance, ratio):  # type: ignore[no-untyped-def]
    n, m = len(a), len(b)
    match = np.full(n, -1, np.int64)
    back, back_distance = np.full(m, -1, np.int64), np.full(m, 1 << 30, np.int64)
    for i in range(n):
        best, second, which = 1 << 30, 1 << 30, -1
        for j in range(m):
            d = hamming(a[i], b[j])
            if d < best:
                second, best, which = best, d, j
            elif d < second:
                second = d
            if d < back_distance[j]:
                back_distance[j], back[j] = d, i
        if best <= max_distance and best <= ratio * second:
            match[i] = which
    for i in range(n):
        if match[i] >= 0 and back[match[i]] != i:
            match[i] = -1
    return match


def match_lines_near(ends_expected: Array, words: Array, ends: Array, words_seen: Array,
                     radius_px: float, max_distance: int, max_angle_deg: float = 12.0,
                     min_overlap: float = 0.4) -> Array:
    """For each expected segment the seen one that lies along it and looks like it, or −1.

    Args:
        ends_expected: (N, 2, 2), NaN where not in view.
        ends: (M, 2, 2).
        radius_px: largest distance of the seen ends from the expected line.
        min_overlap: share of the shorter of both that both cover.
    Returns:
        (N,) int64; both are each other's nearest.
    """
    if len(ends_expected) == 0 or len(ends) == 0:
        return np.full(len(ends_expected), -1, dtype=np.int64)
    return np.asarray(_match_lines(ends_expected, words, ends, words_seen, radius_px,
                                   max_distance, np.cos(np.radians(max_angle_deg)), min_overlap))


@numba.njit(cache=True)
def _match_lines(expected, words, ends, seen, radius, max_distance,  # type: ignore[no-untyped-def]
                 min_cosine, min_overlap):
    n, m = len(expected), len(ends)
    match = np.full(n, -1, np.int64)
    owner, owned = np.full(m, -1, np.int64), np.full(m, 1 << 30, np.int64)
    for i in range(n):
        au, av = expected[i, 0, 0], expected[i, 0, 1]
        du, dv = expected[i, 1, 0] - au, expected[i, 1, 1] - av
        length = np.sqrt(du * du + dv * dv)
        if not length > 1.0:
            continue
        du, dv = du / length, dv / length
        best, which = max_distance + 1, -1
        for j in range(m):
            s0 = (ends[j, 0, 0] - au) * du + (ends[j, 0, 1] - av) * dv
            s1 = (ends[j, 1, 0] - au) * du + (ends[j, 1, 1] - av) * dv
            h0 = abs((ends[j, 0, 1] - av) * du - (ends[j, 0, 0] - au) * dv)
            h1 = abs((ends[j, 1, 1] - av) * du - (ends[j, 1, 0] - au) * dv)
            if 0.5 * (h0 + h1) > radius:
                continue
            eu, ev = ends[j, 1, 0] - ends[j, 0, 0], ends[j, 1, 1] - ends[j, 0, 1]
            size = np.sqrt(eu * eu + ev * ev)
            if abs(eu * du + ev * dv) < min_cosine * size:
                continue
            common = min(max(s0, s1), length) - max(min(s0, s1), 0.0)
            if common < min_overlap * min(size, length):
                continue
            d = hamming(words[i], seen[j])
            if d < best:
                best, which = d, j
        if which >= 0 and best < owned[which]:
            if owner[which] >= 0:
                match[owner[which]] = -1
            owner[which], owned[which] = i, best
            match[i] = which
    return match


def distances(words_a: Array, words_b: Array) -> Array:
    """(N,) bits by which descriptors (N, 4) uint64 differ, row by row."""
    return _BITS[(words_a ^ words_b).view(np.uint8)].reshape(-1, 32).sum(axis=1)
