"""Equirectangular pictures as Cycles reads them: +z on top, row 0 of an array above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def equirect_directions(width: int, height: int) -> NDArray[np.float64]:
    """(height, width, 3) unit directions of the middles of the texels."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    azimuth, polar = -2 * np.pi * (u - 0.5), np.pi * v
    x, y = np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar)
    return np.stack([x, y, np.cos(polar)], -1).astype(np.float64)


def equirect_texels(directions: NDArray[np.floating], width: int, height: int) -> NDArray[np.int64]:
    """(n,) row-major texels that ``directions`` (n, 3), of any length, point to."""
    x, y, z = np.asarray(directions, np.float64).T
    u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
    v = np.arctan2(np.hypot(x, y), z) / np.pi
    column = np.floor(u * width).astype(np.int64) % width
    row = np.clip(np.floor(v * height).astype(np.int64), 0, height - 1)
    return row * width + column
