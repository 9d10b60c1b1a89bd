"""Image textures painted with numpy: (H, W, 3) float arrays, linear Rec.709 albedo, row 0 at the bottom (v = 0)."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float64]


def noise(height: int, width: int, cells: tuple[int, int], seed: int, octaves: int = 4) -> Image:
    """(H, W) smooth tileable noise in about [-1, 1]; ``cells`` = periods of the coarsest octave down and across."""
    random = np.random.default_rng(seed)
    total = np.zeros((height, width))
    for octave in range(octaves):
        rows, columns = (c * 2**octave for c in cells)
        grid = random.standard_normal((rows, columns))
        y, x = np.meshgrid(np.arange(height) * rows / height, np.arange(width) * columns / width, indexing="ij")
        i, j = y.astype(int), x.astype(int)
        s, t = (w * w * (3 - 2 * w) for w in (y - i, x - j))
        i1, j1 = (i + 1) % rows, (j + 1) % columns
        i, j = i % rows, j % columns
        value = (1 - s) * ((1 - t) * grid[i, j] + t * grid[i, j1]) + s * ((1 - t) * grid[i1, j] + t * grid[i1, j1])
        total += value * 0.55**octave
    return total / 1.6


def mix(a: Image, b: Image, t: Image) -> Image:
    """Linear blend of colours by an (H, W) weight."""
    return np.asarray(a) + (np.asarray(b) - np.asarray(a)) * np.clip(t, 0, 1)[..., None]


def planks(height: int = 768, width: int = 960) -> Image:
    """Oak floor of 5 x 4 m: boards 16 cm wide along x, staggered joints, dark gaps."""
    rows, length = 25, 1.25
    y, x = np.meshgrid((np.arange(height) + 0.5) / height * 4, (np.arange(width) + 0.5) / width * 5, indexing="ij")
    row = np.floor(y / (4 / rows)).astype(int)
    random = np.random.default_rng(4)
    shift = random.random(rows)[row] * length
    board = np.floor((x + shift) / length).astype(int)
    tone = random.standard_normal((rows, 8))[row, board]
    hue = random.standard_normal((rows, 8))[row, board]
    slide = random.integers(0, width, rows)
    grain = noise(height, width, (75, 4), 7)
    grain = np.take_along_axis(grain, (np.arange(width)[None] + slide[row]) % width, axis=1)
    color = mix([0.36, 0.205, 0.105], [0.24, 0.125, 0.058], 0.5 + 0.22 * tone + 0.25 * grain)
    color = color * (1 + 0.05 * hue[..., None] * [1.0, 0.0, -1.0])
    across = np.abs((y / (4 / rows)) % 1 - 0.5) * (4 / rows)
    along = np.abs(((x + shift) / length) % 1 - 0.5) * length
    gap = (across > 0.08 - 0.0028) | (along > length / 2 - 0.003)
    return np.where(gap[..., None], color * 0.4, color).clip(0.05, 0.8)


def wood(light: Image, dark: Image, seed: int, size: int = 384) -> Image:
    """A square metre of veneer with grain along u."""
    grain = noise(size, size, (22, 2), seed) + 0.5 * noise(size, size, (70, 5), seed + 1, 2)
    return mix(light, dark, 0.5 + 0.32 * grain).clip(0.05, 0.8)


def rug(height: int = 400, width: int = 340) -> Image:
    """Woven rug: border, stripes and a lozenge field in brick, cream and indigo."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    cream, brick, indigo, ochre = ([0.62, 0.55, 0.43], [0.40, 0.105, 0.065], [0.07, 0.10, 0.19], [0.55, 0.33, 0.09])
    color = np.broadcast_to(np.array(cream), (height, width, 3)).copy()
    lozenge = np.abs((u * 5) % 1 - 0.5) + np.abs((v * 6) % 1 - 0.5)
    color[lozenge < 0.38] = brick
    color[lozenge < 0.22] = ochre
    color[lozenge < 0.10] = indigo
    band = np.abs(v - 0.5)
    color[(band > 0.36) & (band < 0.44)] = brick
    stripes = (band > 0.385) & (band < 0.415)
    color[stripes & (((u * 24) % 1) < 0.5)] = cream
    edge = np.minimum(np.minimum(u, 1 - u) * 1.7, np.minimum(v, 1 - v) * 2.0)
    color[edge < 0.10] = indigo
    color[edge < 0.045] = ochre
    color[edge < 0.03] = indigo
    weave = 1 + 0.06 * noise(height, width, (9, 8), 13, 2)
    return (color * weave[..., None]).clip(0.05, 0.8)


def landscape(height: int = 240, width: int = 352) -> Image:
    """The picture on the wall: layered hills under a low sun."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    color = mix([0.74, 0.50, 0.27], [0.22, 0.36, 0.50], (v - 0.45) / 0.5)
    sun = np.hypot((u - 0.67) * width / height, v - 0.66)
    color[sun < 0.085] = [0.78, 0.62, 0.36]
    layers = [
        (0.56, 0.06, [0.38, 0.31, 0.30]),
        (0.44, 0.08, [0.19, 0.25, 0.24]),
        (0.30, 0.07, [0.10, 0.18, 0.13]),
        (0.15, 0.05, [0.06, 0.08, 0.07]),
    ]
    for k, (base, rough, tone) in enumerate(layers):
        ridge = base + rough * noise(1, width, (1, 3 + k), 31 + k, 5)[0]
        color[v < ridge[None]] = tone
    return (color * (1 + 0.06 * noise(height, width, (40, 60), 40, 2))[..., None]).clip(0.05, 0.8)


def weave(base: Image, seed: int, size: int = 256, strength: float = 0.12) -> Image:
    """Half a square metre of upholstery: threads and slow variation."""
    threads = noise(size, size, (64, 64), seed, 1) * 0.4 + noise(size, size, (5, 5), seed + 1, 2) * 0.6
    return (np.array(base) * (1 + strength * threads[..., None])).clip(0.05, 0.8)


def stripes(a: Image, b: Image, size: int = 256, count: int = 8) -> Image:
    """Striped cloth, half a metre square."""
    u = np.arange(size) / size * count % 1
    on = np.broadcast_to((u < 0.42) | ((u > 0.62) & (u < 0.72)), (size, size))
    return (mix(a, b, on.astype(float)) * (1 + 0.06 * noise(size, size, (64, 64), 5, 2))[..., None]).clip(0.05, 0.8)


def to_image(name: str, color: Image) -> bpy.types.Image:
    """Pack a linear colour array into the .blend as an 8-bit sRGB PNG."""
    height, width, _ = color.shape
    srgb = np.where(color <= 0.0031308, 12.92 * color, 1.055 * np.maximum(color, 1e-9) ** (1 / 2.4) - 0.055)
    image = bpy.data.images.new(name, width, height, alpha=False)
    image.colorspace_settings.name = "sRGB"
    image.pixels.foreach_set(np.concatenate([srgb, np.ones((height, width, 1))], -1).astype(np.float32).ravel())
    image.pack()
    return image
