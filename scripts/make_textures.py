"""Draw the seamless textures of the built-in scenes into scenes/textures/.

Nearly all are grey: materials give them their colour, so that one file serves many surfaces.
Run it again after a change; equal code gives equal pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

Image = NDArray[np.float64]   # (N, N) in [0, 1], or (N, N, 3)
FOLDER = Path(__file__).resolve().parent.parent / "scenes" / "textures"
LEVELS = 32   # grey steps: few enough for PNG to pack noise, too many to be seen


def noise(rng: np.random.Generator, size: int, slope: float, stretch: float = 1.0) -> Image:
    """Periodic noise with spectrum 1/f^slope, mean 0 and deviation 1; long along u if stretched."""
    f = np.fft.fftfreq(size) * size
    radius = np.hypot(f[:, None], f[None, :] * stretch)
    radius[0, 0] = np.inf
    spectrum = np.fft.fft2(rng.standard_normal((size, size))) / np.maximum(radius, 1.0) ** slope
    spectrum[0, 0] = 0.0
    field = np.fft.ifft2(spectrum).real
    return np.asarray((field - field.mean()) / field.std())


def cells(rng: np.random.Generator, size: int, count: int) -> tuple[NDArray[np.int64], Image]:
    """Periodic Voronoi cells: each pixel's cell, and its distance (px) to the cell's border."""
    tree = cKDTree(rng.uniform(0, size, (count, 2)), boxsize=size)
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size), indexing="ij"), -1)
    distance, index = tree.query(grid.reshape(-1, 2), k=2)
    return index[:, 0].reshape(size, size), (distance[:, 1] - distance[:, 0]).reshape(size, size)


def grid_lines(size: int, rows: int, columns: int, width: int, shift: float = 0.0
               ) -> tuple[Image, NDArray[np.int64]]:
    """A wall of blocks, odd rows shifted: mask of the joints, and each pixel's block number."""
    v, u = np.mgrid[0:size, 0:size]
    row = v * rows // size
    moved = (u + np.rint((row % 2) * shift * size / columns).astype(int)) % size
    column = moved * columns // size
    joint = (v % (size / rows) < width) | (moved % (size / columns) < width)
    return joint.astype(float), row * columns + column


def shapes(rng: np.random.Generator, size: int, kind: str, count: int) -> Image:
    """Overlapping polygons of falling size, wrapped at the borders: corners at all scales."""
    canvas = np.full((size, size), 0.6)
    for k in range(count):
        reach = size * 0.34 * (1.0 - 0.88 * (k / count) ** 0.6)
        centre, tone = rng.uniform(0, size, 2), rng.uniform(0.25, 1.0)
        turn = rng.uniform(0, 2 * np.pi)
        corners = {"triangle": 3, "square": 4, "star": 8}[kind]
        radius = reach * (rng.uniform(0.5, 1.0, corners) if kind != "star"
                          else np.tile([1.0, 0.45], 4))
        angle = turn + 2 * np.pi * np.arange(corners) / corners
        polygon = centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        for dx in (-size, 0, size):
            for dy in (-size, 0, size):
                points = np.rint((polygon + np.array([dx, dy])) * 16).astype(np.int32)
                cv2.fillPoly(canvas, [points], float(tone), lineType=cv2.LINE_8, shift=4)
    return canvas


def glyphs(rng: np.random.Generator, size: int) -> Image:
    """Rows of blocks, bars and rings, like print on a parcel."""
    canvas = np.full((size, size), 0.85)
    cell = size // 8
    for row in range(8):
        for column in range(8):
            u, v, kind = column * cell, row * cell, rng.integers(6)
            tone, inset = float(rng.uniform(0.2, 0.6)), int(rng.integers(2, 8))
            a, b = (u + inset, v + inset), (u + cell - inset, v + cell - inset)
            if kind < 2:
                cv2.rectangle(canvas, a, b, tone, -1)
                cv2.rectangle(canvas, (u + cell // 3, v + cell // 3), (u + 2 * cell // 3, v + 2
                              * cell // 3), 0.95, -1)
            elif kind < 4:
                for bar in range(int(a[0]), int(b[0]) - 2, int(rng.integers(5, 12))):
                    cv2.rectangle(canvas, (bar, a[1]), (bar + int(rng.integers(1, 4)), b[1]),
                                  tone, -1)
            elif kind == 4:
                cv2.line(canvas, a, b, tone, 4)
                cv2.line(canvas, (a[0], b[1]), (b[0], a[1]), tone, 4)
    return canvas


def plaster(rng: np.random.Generator) -> Image:
    pits = (noise(rng, 512, 0.3) > 2.4).astype(float)
    return 0.78 + 0.07 * noise(rng, 512, 1.4) + 0.03 * noise(rng, 512, 0.4) - 0.3 * pits


def planks(rng: np.random.Generator) -> Image:
    joint, block = grid_lines(512, 6, 2, 2, 0.37)
    tone = rng.uniform(-0.13, 0.13, block.max() + 1)[block]
    grain = noise(rng, 512, 1.1, stretch=14.0)
    return 0.66 + tone + 0.10 * grain + 0.03 * noise(rng, 512, 0.3) - 0.4 * joint


def veneer(rng: np.random.Generator) -> Image:
    rings = np.sin(1.7 * noise(rng, 256, 1.9, stretch=5.0) * np.pi)
    return 0.70 + 0.11 * rings + 0.09 * noise(rng, 256, 0.9, stretch=10.0)


def brick(rng: np.random.Generator) -> Image:
    joint, block = grid_lines(512, 16, 6, 4, 0.5)
    tone = rng.uniform(-0.20, 0.17, block.max() + 1)[block]
    rough = 0.06 * noise(rng, 512, 0.5) + 0.05 * noise(rng, 512, 1.4)
    return np.where(joint > 0, 0.88 + rough, 0.58 + tone + rough)


def blocks(rng: np.random.Generator) -> Image:
    joint, block = grid_lines(512, 6, 4, 4, 0.5)
    tone = rng.uniform(-0.14, 0.14, block.max() + 1)[block]
    rough = 0.09 * noise(rng, 512, 0.7) + 0.05 * noise(rng, 512, 1.5)
    return np.where(joint > 0, 0.40, 0.72 + tone) + rough


def concrete(rng: np.random.Generator) -> Image:
    pores = (noise(rng, 512, 0.5) > 2.5).astype(float)
    return 0.68 + 0.10 * noise(rng, 512, 1.3) + 0.05 * noise(rng, 512, 0.3) - 0.3 * pores


def asphalt(rng: np.random.Generator) -> Image:
    stones = (noise(rng, 512, 0.35) > 1.5).astype(float)
    _, border = cells(rng, 512, 9)
    cracks = (border + 2.0 * noise(rng, 512, 1.0) < 1.6).astype(float)
    patches = np.sign(noise(rng, 512, 2.4) - 0.9)
    return (0.50 + 0.10 * noise(rng, 512, 0.5) + 0.25 * stones - 0.05 * patches
            + 0.05 * noise(rng, 512, 1.8) - 0.32 * cracks)


def pavers(rng: np.random.Generator) -> Image:
    joint, block = grid_lines(512, 4, 4, 5)
    tone = rng.uniform(-0.16, 0.16, block.max() + 1)[block]
    return np.where(joint > 0, 0.30, 0.70 + tone) + 0.08 * noise(rng, 512, 0.5)


def rug(rng: np.random.Generator) -> Image:
    v, u = np.mgrid[0:256, 0:256]
    diamond = (np.abs(u % 64 - 32) + np.abs(v % 64 - 32)) // 8 % 4
    tone = np.array([0.85, 0.35, 0.6, 0.25])[diamond]
    band = ((u // 32 + v // 32) % 2) * 0.12
    return np.asarray(tone + band + 0.05 * noise(rng, 256, 0.2))


def fabric(rng: np.random.Generator) -> Image:
    v, u = np.mgrid[0:256, 0:256]
    weave = ((u // 4 + v // 4) % 2) * 0.14
    flowers = cells(rng, 256, 40)[0]
    return np.asarray(0.52 + weave + rng.uniform(-0.2, 0.25, 40)[flowers]
                      + 0.03 * noise(rng, 256, 0.2))


def triangles(rng: np.random.Generator) -> Image:
    return shapes(rng, 256, "triangle", 130) + 0.03 * noise(rng, 256, 0.6)


def squares(rng: np.random.Generator) -> Image:
    return shapes(rng, 256, "square", 110) + 0.03 * noise(rng, 256, 0.6)


def stars(rng: np.random.Generator) -> Image:
    return shapes(rng, 256, "star", 90) + 0.03 * noise(rng, 256, 0.6)


def parcel(rng: np.random.Generator) -> Image:
    return glyphs(rng, 256) + 0.04 * noise(rng, 256, 0.9)


def mosaic(rng: np.random.Generator) -> Image:
    index, border = cells(rng, 256, 120)
    tone = rng.uniform(0.3, 1.0, 120)[index]
    return np.where(border < 1.5, 0.22, tone) + 0.03 * noise(rng, 256, 0.6)


def books(rng: np.random.Generator) -> Image:
    canvas, u = np.full((256, 512), 0.12), 3
    while u < 500:
        width, height = int(rng.integers(9, 26)), int(rng.integers(165, 245))
        tone = rng.uniform(0.3, 0.95)
        canvas[256 - height:, u:u + width] = tone
        for _ in range(int(rng.integers(1, 4))):
            at = 256 - height + int(rng.integers(10, height - 25))
            canvas[at:at + int(rng.integers(3, 16)), u + 2:u + width - 2] = rng.uniform(0.2, 1.0)
        u += width + int(rng.integers(1, 3))
    return canvas + 0.02 * rng.standard_normal(canvas.shape)


def poster(rng: np.random.Generator) -> Image:
    """A picture: hills, a sun and houses in few muted colours, with a pale border."""
    size = 256
    canvas = np.ones((size, size, 3)) * rng.uniform(0.55, 0.9, 3)
    cv2.circle(canvas, tuple(rng.integers(50, 200, 2).tolist()), int(rng.integers(18, 40)),
               rng.uniform(0.75, 1.0, 3).tolist(), -1)
    u = np.arange(size)
    for layer in range(4):
        line = 110 + 32 * layer + 18 * np.interp(u, np.linspace(0, size, 9),
                                                 rng.uniform(-1, 1, 9))
        canvas[np.arange(size)[:, None] > line[None, :]] = rng.uniform(0.2, 0.8, 3)
    for _ in range(9):
        a = rng.integers(20, 215, 2) + np.array([0, 20])
        b = a + rng.integers(10, 45, 2)
        cv2.rectangle(canvas, tuple(a.tolist()), tuple(b.tolist()),
                      rng.uniform(0.1, 0.95, 3).tolist(), -1)
    grey = canvas.mean(axis=2, keepdims=True)
    canvas = grey + 0.35 * (canvas - grey) + 0.03 * noise(rng, size, 0.8)[..., None]
    cv2.rectangle(canvas, (0, 0), (size - 1, size - 1), (0.9, 0.9, 0.88), 20)
    return canvas


def siding(rng: np.random.Generator) -> Image:
    v = np.mgrid[0:256, 0:256][0]
    board = v % 32
    return np.asarray(0.80 - 0.45 * (board < 3) - 0.004 * board + 0.06 * noise(rng, 256, 0.9)
                      + rng.uniform(-0.06, 0.06, 8)[v // 32])


def roller(rng: np.random.Generator) -> Image:
    v, u = np.mgrid[0:256, 0:256]
    return np.asarray(0.62 + 0.2 * np.sin(v * 2 * np.pi / 16) - 0.25 * (u % 64 < 3)
                      + 0.06 * noise(rng, 256, 1.1))


def leaves(rng: np.random.Generator) -> Image:
    index, border = cells(rng, 256, 500)
    return (rng.uniform(0.25, 0.95, 500)[index] * np.clip(0.45 + border / 9.0, 0, 1)
            + 0.05 * noise(rng, 256, 0.4))


def grass(rng: np.random.Generator) -> Image:
    return 0.6 + 0.14 * noise(rng, 256, 0.5) + 0.12 * noise(rng, 256, 1.3)


def pane(rng: np.random.Generator) -> Image:
    """A window: white bars, curtains, the reflection of a sky."""
    size = 256
    v, u = np.mgrid[0:size, 0:size]
    glass = 0.20 + 0.25 * (1 - v / size) + 0.06 * noise(rng, size, 1.9)
    for u0, u1 in ((18, 62), (194, 238)):
        glass[:, u0:u1] = 0.62 + 0.12 * np.sin(u[:, u0:u1] * 0.7)
    glass[170:200, 85:120], glass[150:200, 140:165] = 0.6, 0.1
    bars = ((np.minimum(u, size - 1 - u) < 14) | (np.minimum(v, size - 1 - v) < 14)
            | (np.abs(u - size / 2) < 7) | (np.abs(v - 90) < 6))
    return np.where(bars, 0.93, glass)


def door(rng: np.random.Generator) -> Image:
    size = 256
    canvas = 0.62 + 0.06 * noise(rng, size, 1.0, stretch=0.1)
    for v0, v1 in ((20, 110), (130, 235)):
        for u0, u1 in ((24, 116), (140, 232)):
            canvas[v0:v1, u0:u1] -= 0.2
            canvas[v0 + 10:v1 - 10, u0 + 10:u1 - 10] += 0.34
    cv2.circle(canvas, (235, 122), 7, 1.0, -1)
    return canvas


def wheel(rng: np.random.Generator) -> Image:
    """A rim with five spokes; the tile is as wide as the wheel."""
    v, u = np.mgrid[0:256, 0:256] - 127.5
    radius, angle = np.hypot(u, v), np.arctan2(v, u)
    spoke = np.cos(5 * angle) > 0.25 + radius / 400
    rim = np.where(spoke | (radius < 22), 0.92, 0.18)
    rim = np.where(radius > 84, 0.85, rim)
    tyre = 0.16 + 0.05 * noise(rng, 256, 0.6)
    return np.where(radius > 94, tyre, rim)


def paint(rng: np.random.Generator) -> Image:
    """Car paint: splashes of dirt, scratches and a few stickers."""
    dirt = np.clip(noise(rng, 512, 1.3) - 0.4, 0, 2)
    canvas = 0.92 - 0.13 * dirt - 0.2 * (noise(rng, 512, 0.8) > 2.2)
    for _ in range(26):
        u, v = (int(x) for x in rng.integers(0, 480, 2))
        w, h = (int(x) for x in rng.integers(8, 34, 2))
        tone = float(rng.uniform(0.35, 0.75))
        canvas[v:v + h, u:u + w] = tone
        canvas[v + h // 4:v + h // 2, u + w // 4:u + 3 * w // 4] = 1.0 - 0.5 * tone
    return canvas + 0.02 * noise(rng, 512, 0.4)


def cabin_glass(rng: np.random.Generator) -> Image:
    streaks = gaussian_filter(noise(rng, 256, 1.5), (1, 6), mode="wrap")
    return 0.42 + 0.14 * streaks + 0.25 * (noise(rng, 256, 1.1) > 1.6)


def rubble(rng: np.random.Generator) -> Image:
    """Natural stones of all sizes in mortar."""
    index, border = cells(rng, 512, 90)
    tone = rng.uniform(0.42, 0.9, 90)[index]
    rough = 0.07 * noise(rng, 512, 0.7) + 0.05 * noise(rng, 512, 1.5)
    return np.where(border < 5.0 + 2.0 * noise(rng, 512, 1.2), 0.9, tone) + rough


def timber(rng: np.random.Generator) -> Image:
    """Dark beams before plaster, some of them slanting."""
    canvas = 0.86 + 0.04 * noise(rng, 512, 1.3)
    beams = np.zeros((512, 512))
    for v in (0, 190, 330):
        cv2.rectangle(beams, (0, v), (511, v + 22), 1.0, -1)
    for u in (30, 150, 262, 410):
        cv2.rectangle(beams, (u, 0), (u + 20, 511), 1.0, -1)
    for a, b in (((40, 330), (150, 210)), ((420, 20), (275, 190)), ((160, 352), (262, 511)),
                 ((511, 340), (420, 200))):
        cv2.line(beams, a, b, 1.0, 18)
    return np.where(beams > 0, 0.30 + 0.08 * noise(rng, 512, 1.0, stretch=4.0), canvas)


def tiles(rng: np.random.Generator) -> Image:
    """Small glazed tiles, every fifth row dark, with a few that were replaced."""
    joint, block = grid_lines(512, 20, 20, 3)
    tone = rng.uniform(-0.07, 0.07, block.max() + 1) - 0.4 * (rng.uniform(size=400) < 0.04)
    dark = np.where(np.mgrid[0:512, 0:512][0] * 20 // 512 % 5 == 0, -0.32, 0.0)
    return np.where(joint > 0, 0.55, 0.82 + tone[block] + dark) + 0.03 * noise(rng, 512, 0.8)


def panels(rng: np.random.Generator) -> Image:
    """Large cladding panels of two tones with stains below their joints."""
    joint, block = grid_lines(512, 5, 3, 5, 0.33)
    tone = rng.uniform(-0.22, 0.16, block.max() + 1)[block]
    drips = np.clip(noise(rng, 512, 1.2, stretch=0.15), 0.0, 2.0)
    return np.where(joint > 0, 0.22, 0.74 + tone - 0.08 * drips) + 0.03 * noise(rng, 512, 0.5)


def casement(rng: np.random.Generator) -> Image:
    """A window of six small panes between slatted shutters."""
    size = 256
    v, u = np.mgrid[0:size, 0:size]
    glass = 0.16 + 0.22 * (1 - v / size) + 0.08 * noise(rng, size, 1.8)
    canvas = np.where((np.abs(u - 128) < 5) | (v % 85 < 6), 0.95, glass)
    shutter = 0.45 + 0.16 * (v % 14 < 4) + 0.04 * noise(rng, size, 1.0)
    canvas = np.where((u < 62) | (u > 194), shutter, canvas)
    rim = (np.minimum(v, size - 1 - v) < 8) | (np.abs(u - 62) < 6) | (np.abs(u - 194) < 6)
    return np.where(rim, 0.9, canvas)


def blind(rng: np.random.Generator) -> Image:
    """A wide pane with a half-drawn blind and things on the sill."""
    size = 256
    v, u = np.mgrid[0:size, 0:size]
    glass = 0.34 + 0.2 * np.sin((u + v) / 90.0) + 0.06 * noise(rng, size, 1.9)
    canvas = np.where(v < 120, 0.72 + 0.12 * (v % 12 < 4), glass)
    for at in (36, 88, 170, 206):
        cv2.ellipse(canvas, (at, 226), (14, 22), 0, 0, 360, float(rng.uniform(0.1, 0.9)), -1)
    rim = (np.minimum(u, size - 1 - u) < 9) | (np.minimum(v, size - 1 - v) < 9) \
        | (np.abs(u - 150) < 5)
    return np.where(rim, 0.25, canvas)


DRAWN: dict[str, Callable[[np.random.Generator], Image]] = {
    f.__name__: f for f in (plaster, planks, veneer, brick, blocks, concrete, asphalt, pavers, rug,
                            fabric, triangles, squares, stars, parcel, mosaic, books, siding,
                            roller, leaves, grass, pane, door, wheel, paint, cabin_glass)}


# Drawn later: in an order of their own, so that those above keep their pixels.
ADDED: dict[str, Callable[[np.random.Generator], Image]] = {
    **{f.__name__: f for f in (rubble, timber, tiles, panels, casement, blind)},
    **{f"poster_{k}": poster for k in "efgh"}}


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    first = {**DRAWN, **{f"poster_{k}": poster for k in "abcd"}}
    pictures = [*sorted(first.items()), *ADDED.items()]
    for number, (name, draw) in enumerate(pictures):
        image = np.clip(draw(np.random.default_rng(number + 1)), 0.0, 1.0)
        steps = np.rint(image * (LEVELS - 1)) * (255.0 / (LEVELS - 1))
        path = FOLDER / f"{name}.png"
        if not cv2.imwrite(str(path), np.rint(steps).astype(np.uint8),
                           [cv2.IMWRITE_PNG_COMPRESSION, 9]):
            raise OSError(f"cannot write {path}")
    total = sum(path.stat().st_size for path in FOLDER.glob("*.png"))
    print(f"{len(pictures)} textures, {total / 1e6:.2f} MB, in {FOLDER}")


if __name__ == "__main__":
    main()
