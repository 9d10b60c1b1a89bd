"""Channels that were clipped in every photo, from texels that look alike in the others."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.textures.bake import complete_channels

CREAM, RED = np.array([0.80, 0.74, 0.60]), np.array([0.60, 0.20, 0.15])
NAN = np.nan


def test_without_similar_texels_a_clipped_channel_has_the_colour_of_its_region() -> None:
    completed = complete_channels(np.array([[NAN, 0.3, 0.05]]), np.zeros(1, int), np.array([[0.8, 0.6, 0.1]]))
    assert completed[0] == pytest.approx([0.4, 0.3, 0.05], rel=1e-5)  # half as bright, as yellow


@pytest.mark.parametrize("clipped", [(0,), (2,), (0, 1), (1, 2)])
def test_a_white_rug_with_a_red_pattern_is_white_in_the_sun(clipped: tuple[int, ...]) -> None:
    """A third of the rug is seen whole, brighter and darker by a tenth; the white of the rest is clipped."""
    rng = np.random.default_rng(0)
    white = rng.random(3000) < 0.5
    truth = np.where(white[:, None], CREAM, RED) * rng.uniform(0.9, 1.1, (3000, 1))
    value = truth.copy()
    sunny = white & (np.arange(3000) >= 1000)
    value[np.ix_(sunny, clipped)] = NAN
    mean = np.array([truth.mean(0)])
    completed = complete_channels(value, np.zeros(3000, int), mean)
    assert completed[sunny] == pytest.approx(truth[sunny], rel=0.02)
    np.testing.assert_array_equal(completed[~sunny], truth[~sunny].astype(np.float32))


def test_clipped_channels_are_completed_within_their_region() -> None:
    """Two regions as blue as each other; a few texels of a third are not enough to tell."""
    yellow, pink = np.array([0.8, 0.7, 0.2]), np.array([0.8, 0.3, 0.2])
    value = np.concatenate([np.tile(yellow, (50, 1)), np.tile(pink, (50, 1)), np.tile(pink, (5, 1))])
    region = np.repeat([0, 1, 2], [50, 50, 5])
    value[[0, 50, 100], :2] = NAN
    mean = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [0.4, 0.4, 0.2]])
    completed = complete_channels(value, region, mean)
    assert completed[0] == pytest.approx(yellow) and completed[50] == pytest.approx(pink)
    assert completed[100] == pytest.approx([0.4, 0.4, 0.2])
