"""Changes of a scene's look: by seed before it is compiled, by the dials every scene has after."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import mujoco
import numpy as np

from slam.geometry.arrays import Array


def generator(seed: int, stage: int) -> np.random.Generator:
    """An independent generator for one stage of building a scene."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stage,)))


def hue_rgba(hue: float, saturation: float, value: float) -> list[float]:
    """Opaque RGBA of a hue (turns), saturation and value in [0, 1]."""
    return [*colorsys.hsv_to_rgb(hue % 1.0, saturation, value), 1.0]


def set_texture(material: mujoco.MjsMaterial, texture: str) -> None:
    """Give a material another colour texture."""
    names = list(material.textures)
    names[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture
    material.textures = names


def jittered_rgba(rng: np.random.Generator, rgb: Sequence[float], spread: float) -> list[float]:
    """A colour near `rgb`: brightness and tint each changed by up to `spread` (relative)."""
    bright = rng.uniform(1.0 - spread, 1.0 + spread)
    tint = rng.uniform(1.0 - 0.4 * spread, 1.0 + 0.4 * spread, size=3)
    return [*np.clip(np.asarray(rgb) * bright * tint, 0.0, 1.0).tolist(), 1.0]


def set_texture_contrast(model: mujoco.MjModel, contrast: float) -> None:
    """Blend every texture but the sky towards its mean colour; 1 changes nothing, 0 leaves it."""
    for texture in range(model.ntex):
        if model.tex_type[texture] != mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            pixels = _pixels(model, texture)
            mean = pixels.mean(axis=0, dtype=np.float64)
            pixels[:] = np.rint(mean + contrast * (pixels - mean)).astype(np.uint8)


def scale_light(model: mujoco.MjModel, factor: float) -> None:
    """Multiply all lights, the ambient light and the sky by `factor`."""
    model.light_ambient *= factor
    model.light_diffuse *= factor
    model.light_specular *= factor
    head = model.vis.headlight
    head.ambient, head.diffuse = head.ambient * factor, head.diffuse * factor
    head.specular = head.specular * factor
    for texture in range(model.ntex):
        if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            pixels = _pixels(model, texture)
            pixels[:] = np.clip(np.rint(pixels * factor), 0, 255).astype(np.uint8)


def _pixels(model: mujoco.MjModel, texture: int) -> Array:
    """The texture as a writeable (pixels, channels) view."""
    channels = int(model.tex_nchannel[texture])
    count = int(model.tex_height[texture]) * int(model.tex_width[texture]) * channels
    start = int(model.tex_adr[texture])
    return np.asarray(model.tex_data[start:start + count]).reshape(-1, channels)
