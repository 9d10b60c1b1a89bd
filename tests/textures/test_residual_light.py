"""Slow changes of albedo that are errors of the light, and those that are paint."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.surface.irradiance import IrradianceField
from iris_addon.textures.paint import residual_light

SIDE, SIZE = 40, 0.1
ROW, COLUMN = (index.ravel() for index in np.indices((SIDE, SIDE)))
WALL = np.full((SIDE * SIDE, 3), 0.7)
BLOTCHES = np.exp(0.025 * np.sin(ROW / 2.5) * np.cos(COLUMN / 3.0))[:, None] * [1.0, 0.99, 1.0]


def corrected(seen: np.ndarray, dielectric: bool = True, region: np.ndarray | None = None) -> np.ndarray:
    """Albedo (P, 3) of a plane of square patches, three pixels each, once divided by what is taken for light."""
    position = np.stack([ROW * SIZE, COLUMN * SIZE, np.zeros(len(ROW))], 1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(ROW), 1))
    field = IrradianceField.of(position, normal, np.full(len(ROW), SIZE, np.float32))
    region = np.zeros(len(ROW), np.int32) if region is None else region
    patch = np.repeat(np.arange(len(ROW)), 3)
    even = np.full(region.max() + 1, dielectric)
    return seen / residual_light(field, region, even, patch, seen[patch], np.ones((len(patch), 3)))


def spread(albedo: np.ndarray) -> float:
    return float(np.log(albedo / albedo.mean(0)).std())


def test_an_even_wall_loses_its_blotches_and_keeps_its_level() -> None:
    seen = WALL * BLOTCHES
    assert spread(corrected(seen)) < 0.35 * spread(seen)
    assert corrected(seen).mean() == pytest.approx(0.7, rel=0.01)


HALVES = (ROW >= SIDE // 2).astype(np.int32)
GRADIENT = np.exp(0.25 * (COLUMN / SIDE - 0.5))[:, None]


def test_planks_keep_their_difference_beside_an_even_wall() -> None:
    planks = WALL * np.where((HALVES == 1) & (ROW // 5 % 2 == 0), 0.7, 1.0)[:, None]
    floor = HALVES == 1
    assert spread(corrected(planks * BLOTCHES, region=HALVES)[floor]) > 0.9 * spread(planks[floor])


def test_two_paints_of_one_region_stay_two_also_where_nothing_else_is_seen() -> None:
    """Walls and ceiling of one piece, of which no other region tells how well the light is known."""
    level = np.where(HALVES == 1, 0.684, 0.8)
    found = corrected(level[:, None] * BLOTCHES)
    for half in (HALVES == 0, HALVES == 1):
        assert np.median(found[half]) == pytest.approx(level[half][0], rel=0.02)


def test_a_gradient_beside_an_even_wall_is_paint() -> None:
    painted = WALL * np.where((HALVES == 1)[:, None], GRADIENT, 1.0)
    found = corrected(painted, region=HALVES)[HALVES == 1]
    assert spread(found) > 0.8 * spread(GRADIENT[HALVES == 1])


def test_a_stain_on_an_even_wall_stays() -> None:
    stained = WALL.copy()
    stain = np.hypot(ROW - 20, COLUMN - 20) < 4
    stained[stain] = 0.4
    found = corrected(stained * BLOTCHES)
    assert found[np.hypot(ROW - 20, COLUMN - 20) < 2].mean() == pytest.approx(0.4, rel=0.05)
    assert found[np.hypot(ROW - 20, COLUMN - 20) > 7].mean() == pytest.approx(0.7, rel=0.02)


def test_fine_detail_of_an_even_region_stays() -> None:
    weave = WALL * np.where((ROW + COLUMN) % 2 == 0, 0.9, 1.1)[:, None]
    assert spread(corrected(weave)) > 0.9 * spread(weave)


def test_paint_of_two_regions_is_not_mixed_and_metals_are_left_alone() -> None:
    region = (ROW >= SIDE // 2).astype(np.int32)
    two = WALL * np.where(region == 0, 1.0, 0.3)[:, None]
    assert corrected(two, region=region) == pytest.approx(two, rel=1e-6)
    assert (corrected(WALL * BLOTCHES, dielectric=False) == WALL * BLOTCHES).all()
