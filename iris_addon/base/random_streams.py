"""Random streams by name: every use of randomness draws numbers of its own.

A stage draws the same numbers whether the stages before it ran or were read back, and no two stages share a stream.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, name: str, *index: int) -> np.random.Generator:
    """The generator of one use of randomness.

    Seed, name and indices are hashed as one tuple. Numpy itself pads lists of seeds with zeros, so that
    ``default_rng([1, 2])`` and ``default_rng([1, 2, 0])`` are one stream.

    Args:
        seed: of the solve.
        name: "room.use", written out at one place of the code only.
        index: of a repeated use, such as the round.

    Example:
        >>> stream(0, "surface.patches").random() == stream(0, "surface.patches").random()
        True
        >>> stream(0, "materials.aimed_rays").random() == stream(0, "materials.aimed_rays", 0).random()
        False
    """
    key = repr((int(seed), name, *map(int, index)))
    return np.random.default_rng(int.from_bytes(hashlib.blake2b(key.encode(), digest_size=16).digest()))
