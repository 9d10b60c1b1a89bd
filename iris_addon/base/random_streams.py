"""Random streams by name: every use of randomness draws numbers of its own.

A stage draws the same numbers whether the stages before it ran or were read back, and no two stages share a stream.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

STREAMS: Mapping[str, int] = {
    "textures.charts": 0,
    "surface.patches": 1,
    "transport.gather_rays": 2,
    "response.observations": 3,
    "response.overlap": 4,
    "evaluate.fitted_pixels": 5,
    "results.pixel_lobes": 6,
    "results.held_out_pixels": 7,
    "cameras.points": 8,
    "lighting.shadow_rays": 17,
    "lighting.shell_irradiance": 23,
    "materials.gloss": 29,
    "materials.specular_lobes": 31,
    "materials.glossy_bounce": 37,
    "materials.aimed_rays": 41,
    "lighting.hidden_emitters": 43,
    "surface.scan": 47,
    "lighting.highlights": 53,
    "lighting.sun": 59,
    "lighting.sun_pixels": 61,
    "capture.points_to_mesh": 67,
    "lighting.aimed_at_sunlight": 71,
    "transport.openings": 73,
    "materials.mirrors": 79,
    "lighting.patterns": 83,
    "lighting.profiles": 89,
}
"""The number of each use, "room.use". A new use takes a new number; numbers stay, so that results do."""


def stream(seed: int, name: str, *index: int) -> np.random.Generator:
    """The generator of one use of randomness.

    Numpy pads lists of seeds with zeros, so that ``default_rng([1, 2])`` and ``default_rng([1, 2, 0])`` are one stream.
    Therefore each name stands at one place of the code, which gives it the same number of indices every time.

    Args:
        seed: of the solve.
        name: a key of :data:`STREAMS`.
        index: of a repeated use, such as the round.

    Raises:
        KeyError: the name has no number.

    Example:
        >>> stream(0, "surface.patches").random() == stream(0, "surface.patches").random()
        True
        >>> stream(0, "surface.patches").random() == stream(0, "transport.gather_rays").random()
        False
    """
    return np.random.default_rng([seed, STREAMS[name], *index])
