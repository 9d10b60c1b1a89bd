"""Regions that share a paint: which are joined, and what the small ones gain by it."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.textures.paint import find_paint, shared_paint

WHITE = np.array([0.8, 0.78, 0.74])
UNTINTED = np.ones(3)
FRAME, SLAT = 3000, 60
"""Texels of the large region, the first, and of each small one."""


def window(light_off: np.ndarray, error: float, tint: np.ndarray = UNTINTED) -> tuple[np.ndarray, ...]:
    """A frame of white paint on even ground and slats of it, each under light that is off by its own factor.

    Args:
        light_off: (k,) of the log irradiance at each slat.
        error: what is known of that.
        tint: of the slats' own colour.
    """
    region = np.concatenate([np.zeros(FRAME, np.int64), np.repeat(1 + np.arange(len(light_off)), SLAT)])
    off = np.concatenate([[0.0], light_off])[region]
    noise = np.random.default_rng(0).normal(0, 0.01, len(region))
    albedo = WHITE * np.exp(off + noise)[:, None]
    albedo[region > 0] *= tint
    return albedo, np.where(region > 0, error, 0.015), region


def joined(albedo: np.ndarray, error: np.ndarray, region: np.ndarray, painted: np.ndarray | None = None) -> np.ndarray:
    return shared_paint(albedo, error, region, np.ones(region.max() + 1, bool) if painted is None else painted)


def test_slats_beside_a_window_have_the_paint_of_its_frame() -> None:
    off = np.random.default_rng(1).uniform(-0.08, 0.08, 30)
    albedo, error, region = window(off, 0.1)
    label = joined(albedo, error, region)
    assert (label == 0).all()
    paint = find_paint(albedo, error, label[region], np.ones(31, bool)).of_regions(label)
    assert paint.paints == 1 and paint.plain_regions == 31
    evened = paint.evened(albedo, error, region)
    before, after = (np.abs(np.log(shown / WHITE))[region > 0].mean() for shown in (albedo, evened))
    assert before > 0.03 and after < 0.1 * before


@pytest.mark.parametrize(("error", "same"), [(0.015, False), (0.3, True)])
def test_a_darker_region_is_another_paint_only_where_its_light_is_certain(error: float, same: bool) -> None:
    label = joined(*window(np.full(5, -0.2), error))
    assert (label[1:] == 0).all() if same else (label[1:] == 1).all(), "and the five are one paint in any case"


def test_light_is_off_in_brightness_rather_than_in_colour() -> None:
    """As far from the frame as what light of that error explains, but in another hue."""
    tint = np.exp([0.12, 0.0, -0.12])
    assert (joined(*window(np.zeros(4), 0.1)) == 0).all()
    assert (joined(*window(np.zeros(4), 0.1, tint))[1:] == 1).all()


def test_metals_and_regions_of_few_texels_share_no_paint() -> None:
    albedo, error, region = window(np.zeros(4), 0.1)
    few = (region != 2) | (np.cumsum(region == 2) < 4)
    clipped = np.where((region == 3)[:, None], [np.nan, 1, 1], albedo)
    painted = np.array([True, False, True, True, True])
    assert joined(clipped[few], error[few], region[few], painted).tolist() == [0, 1, 2, 3, 0]


def test_small_steps_do_not_join_what_is_far_apart() -> None:
    """A row of regions, each a little brighter than the one before: who stands for others is not moved by them."""
    steps = 0.04 * np.arange(1, 20)
    label = joined(*window(steps - 0.8, 0.015))
    level = np.concatenate([[0.0], steps - 0.8])
    assert np.abs(level - level[label]).max() < 0.09
    assert 4 < len(np.unique(label)) < 12
