"""Charts keep their shape, their order of size and texels to linear lookups of their own, and fill the square."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.textures.atlas import plane_areas
from iris_addon.textures.packing import pack, shelves

SIZE = 256


def right_triangles(legs: np.ndarray) -> np.ndarray:
    """(n, 3, 2) one right triangle with legs (n, 2) per chart, its rectangle higher than wide and from 0."""
    legs = np.sort(legs, axis=1)
    corners = np.zeros((len(legs), 3, 2))
    corners[:, 1, 0], corners[:, 2, 1] = legs[:, 0], legs[:, 1]
    return corners


def points_of(corners: np.ndarray) -> np.ndarray:
    """(n, p, 2) points along the sides of triangles, and inside."""
    t = np.linspace(0, 1, 64, endpoint=False)[None, :, None]
    sides = [corners[:, None, k] * (1 - t) + corners[:, None, (k + 1) % 3] * t for k in range(3)]
    border = np.concatenate(sides, axis=1)
    middle = corners.mean(1, keepdims=True)
    return np.concatenate([middle + part * (border - middle) for part in (1.0, 0.75, 0.5, 0.25)], axis=1)


@pytest.mark.parametrize("spread", [0.3, 2.0])
@pytest.mark.parametrize("count", [1, 7, 300, 1500])
def test_texels_beside_two_charts_are_not_the_same(count: int, spread: float) -> None:
    rng = np.random.default_rng(count)
    corners = right_triangles(np.exp(spread * rng.standard_normal((count, 2))))
    placed = pack(corners, np.arange(count), SIZE)
    assert placed.min() >= 1 - 1e-3
    assert placed.max() <= SIZE - 1 + 1e-3
    points = points_of(placed)
    near = np.floor(points + [[[[-0.999, -0.999]]], [[[0.999, -0.999]]], [[[-0.999, 0.999]]], [[[0.999, 0.999]]]])
    read = np.column_stack([near.reshape(-1, 2), np.tile(np.repeat(np.arange(count), points.shape[1]), 4)])
    by_chart = np.unique(read, axis=0)
    assert len(np.unique(by_chart[:, :2], axis=0)) == len(by_chart)


def test_charts_are_moved_and_scaled_by_one_factor_and_nothing_else() -> None:
    rng = np.random.default_rng(0)
    corners = right_triangles(rng.uniform(0.05, 1, (200, 2)))
    placed = pack(corners, np.arange(200), SIZE)
    factor = np.sqrt(plane_areas(placed) / plane_areas(corners))
    assert np.allclose(factor, factor[0])
    assert np.allclose(placed - placed[:, :1], factor[0] * (corners - corners[:, :1]), atol=1e-6)


def test_squares_fill_most_of_the_square() -> None:
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
    placed = pack(np.tile(square, (49, 1, 1)), np.repeat(np.arange(49), 2), SIZE)
    assert plane_areas(placed).sum() > 0.5 * SIZE**2


def test_a_chart_longer_than_the_square_is_shrunk_and_leaves_the_others_their_size() -> None:
    corners = right_triangles(np.concatenate([[[0.01, 1000.0]], np.ones((100, 2))]))
    placed = pack(corners, np.arange(101), SIZE)
    assert SIZE / 2 < np.ptp(placed[0, :, 1]) <= SIZE
    assert np.ptp(placed[1:, :, 1], axis=1).min() > 0.6 * SIZE / 10


def test_a_chart_without_width_has_a_place_whichever_way_its_line_runs() -> None:
    corners = right_triangles(np.ones((4, 2)))
    corners[1] = [[0, 0], [0.5, 1], [0.25, 0.5]]
    corners[2] = [[0, 0], [0, 1], [0, 0.5]]
    placed = pack(corners, np.arange(4), SIZE)
    factor = np.sqrt(plane_areas(placed[:1]) / plane_areas(corners[:1]))
    assert np.allclose(placed - placed[:, :1], factor[0] * (corners - corners[:, :1]), atol=1e-6)


def test_packing_twice_gives_the_same() -> None:
    corners = right_triangles(np.random.default_rng(3).uniform(0.05, 1, (500, 2)))
    first, second = (pack(corners, np.arange(500), SIZE) for _ in range(2))
    assert np.array_equal(first, second)


def test_more_charts_than_texels_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        pack(right_triangles(np.ones((400, 2))), np.arange(400), 16)


def test_shelves_hold_rectangles_side_by_side() -> None:
    extent = np.random.default_rng(5).uniform(0.1, 1, (50, 2))
    shelf, start = shelves(extent, 5.0)
    for k in range(shelf.max() + 1):
        order = np.argsort(start[shelf == k])
        assert np.allclose(start[shelf == k][order], np.append(0, np.cumsum(extent[shelf == k, 0][order])[:-1]))
        assert extent[shelf == k, 1].min() >= extent[shelf > k, 1].max(initial=0)
