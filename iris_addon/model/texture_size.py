"""The size of textures: what may be asked for, and what it takes in Blender's memory. Needs Python's own modules alone.

A side is in texels; a density in texels per metre on the surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

SMALLEST_SIDE, LARGEST_SIDE = 256, 16384
"""Of an atlas whose side is asked for, a power of two."""
LOWEST_DENSITY, HIGHEST_DENSITY = 0.1, 1e5
"""Texels per metre that may be asked for."""
BLENDER_FLOAT_MAPS, BLENDER_BYTE_MAPS = 1, 3
"""Images of a result in Blender: base colour has floats; metallic, roughness and confidence have bytes."""
CHANNELS, FLOAT_BYTES = 4, 4
"""Blender keeps four channels of every image, of a byte or a float each."""


@dataclass(frozen=True)
class AskedSize:
    """How large an atlas is to be.

    Attributes:
        most: its side, at most.
        side: its side where that is given; None for one that follows from the density.
        density: texels per metre, everywhere; None for as many as the photos resolve.
    """

    most: int
    side: int | None = None
    density: float | None = None

    @property
    def words(self) -> str:
        """A name for it, in file names: no two sizes have the same."""
        return f"{self.most}-{self.side or 'auto'}-{self.density or 'auto'}"


def atlas_size_of(value: Any) -> int | Literal["auto"]:
    """``value``, a number or text, as the side of an atlas or "auto"; raises ValueError, which says the bounds."""
    side = _number(value)
    if value != "auto" and (
        side is None or not SMALLEST_SIDE <= side <= LARGEST_SIDE or side != int(side) or int(side) & (int(side) - 1)
    ):
        raise ValueError(f"neither auto nor a power of two from {SMALLEST_SIDE} to {LARGEST_SIDE}")
    return "auto" if side is None else int(side)


def density_of(value: Any) -> float | Literal["auto"]:
    """``value``, a number or text, as texels per metre or "auto"; raises ValueError, which says the bounds."""
    density = _number(value)
    if value != "auto" and (density is None or not LOWEST_DENSITY <= density <= HIGHEST_DENSITY):
        raise ValueError(f"neither auto nor a number from {LOWEST_DENSITY:g} to {HIGHEST_DENSITY:g}")
    return "auto" if density is None else density


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def blender_bytes(side: int, patterned: bool = False) -> int:
    """Bytes that the images of a result take in Blender's memory; packed files and the graphics card not counted.

    Args:
        patterned: whether there is one of the pattern of lamps, too.
    """
    return CHANNELS * (FLOAT_BYTES * (BLENDER_FLOAT_MAPS + patterned) + BLENDER_BYTE_MAPS) * side * side


def in_blender(side: int, taken: int | None = None) -> str:
    """The size of textures and of their memory: "4096 x 4096, 0.5 GB".

    Args:
        taken: bytes of the memory, where they are known.
    """
    gigabytes = (taken or blender_bytes(side)) / 1e9
    return f"{side} x {side}, {gigabytes:.1f} GB" if gigabytes >= 0.1 else f"{side} x {side}, {1000 * gigabytes:.0f} MB"
