"""Which observations clip, in photos with noise and without."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.response.clipping import Clipping, drop_below_white, photo_noise
from iris_addon.response.observations import Observations
from tests.engine_room import observe_off_edges

PATCHES, PIXELS = 300, 16
LEVELS = np.repeat([0.8, 0.965, 1.0], PATCHES // 3)
"""Display values of the patches: far below white, near it, and beyond what the photo can show."""


def photographed(noise: float, compressed: float = 0.0) -> Observations:
    """Even patches in one photo whose noise is cut off at white; afterwards ``compressed`` takes every other pixel
    below it."""
    rng = np.random.default_rng(3)
    patch = np.repeat(np.arange(PATCHES), PIXELS)
    clips = LEVELS[patch] == 1.0
    z = np.where(clips, 1.0, np.minimum(LEVELS[patch] + noise * rng.standard_normal(len(patch)), 1.0))
    z = z - compressed * np.abs(rng.standard_normal(len(patch))) * (rng.random(len(patch)) < 0.5)
    z = np.repeat(np.rint(255 * np.clip(z, 0, 1))[:, None] / 255, 3, 1)
    return observe_off_edges(patch, np.zeros(len(patch), int), z, rng)


def level(o: Observations) -> np.ndarray:
    return LEVELS[o.patch]


def test_without_noise_what_has_clipped_pixels_clips_and_all_else_is_measured() -> None:
    o = photographed(0.0)
    clipping = Clipping.of(o)
    assert photo_noise(o) == 0
    np.testing.assert_array_equal(clipping.share, o.saturated)
    np.testing.assert_array_equal(clipping.measured, level(o) < 1)


@pytest.mark.parametrize("noise", [0.008, 0.012])
def test_noise_is_measured_off_its_smoothest_patches(noise: float) -> None:
    """Below its true value, as the smoothest of patches of 16 pixels are."""
    assert 0.5 * noise < photo_noise(photographed(noise)) < noise


def test_clipped_patches_clip_though_compression_takes_pixels_off_white() -> None:
    o = photographed(0.008, compressed=0.012)
    clipping, white, near = Clipping.of(o), level(o) == 1, level(o) == 0.965
    assert (o.saturated[white] <= 0.5).any(), "each clipped patch shows as much by its pixels alone"
    assert (clipping.share[white] > 0.5).mean() > 0.95
    assert (clipping.share[near] <= 0.5).all()
    assert not clipping.measured[white | near].any() and clipping.measured[level(o) == 0.8].all()
    # The mean of a half-normal deviation is 0.8 of it; three in four observations have no more than somewhat above.
    assert 0.8 * 0.012 < drop_below_white(o) < 1.3 * 0.012
