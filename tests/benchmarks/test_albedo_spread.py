"""The spread of the albedo of one surface: closed forms, and what lies on it is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.albedo_spread import Texels, spread_of
from iris_addon.base.errors import BadInput
from iris_addon.model.capture import Mesh
from iris_addon.results.result import Result
from tests.blender_room import camera, room

SIDE = 256


def table(albedo: np.ndarray) -> Result:
    """A table of 2 × 2 m below a camera, all of the atlas (SIDE, SIDE, 3) its ``albedo``."""
    corners = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], float)
    uv = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    made = room(mesh=Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), uv))
    flat = np.ones((SIDE, SIDE), np.float32)
    maps = replace(
        made.textures, base_color=albedo.astype(np.float32), roughness=flat, metallic=0 * flat, confidence=flat
    )
    return replace(made, textures=maps)


def test_a_gradient_counts_in_full_and_grain_in_texels_alone() -> None:
    """Of values even between 1 − g and 1 + g the median absolute deviation is g / 2."""
    gradient = np.tile(np.linspace(0.8, 1.2, SIDE)[:, None, None] * 0.5, (1, SIDE, 3))
    found = Texels(table(gradient)).spread_at(camera(), 0.5, 0.5, reach=1.0)
    assert found.texels == pytest.approx(1.4826 * 0.1, rel=0.02)
    assert found.cells == pytest.approx(1.4826 * 0.1, rel=0.05)
    grain = 0.5 * np.random.default_rng(0).uniform(0.8, 1.2, (SIDE, SIDE, 1)) * np.ones(3)
    found = Texels(table(grain)).spread_at(camera(), 0.5, 0.5, reach=1.0)
    assert found.texels == pytest.approx(1.4826 * 0.1, rel=0.02)
    assert found.cells < 0.05


def test_what_lies_on_the_surface_is_left_out() -> None:
    """A red book that is much darker covers a sixth of a white table."""
    albedo = np.full((SIDE, SIDE, 3), 0.8)
    albedo[:100, :110] = [0.3, 0.05, 0.05]
    found = Texels(table(albedo)).spread_at(camera(), 0.5, 0.5, reach=1.0)
    assert found.texels == 0 and found.albedo == pytest.approx([0.8] * 3, rel=1e-3)


def test_cells_of_few_texels_say_nothing() -> None:
    found = spread_of(np.full((5, 3), 0.5), np.zeros((5, 2)))
    assert found.n_cells == 0 and np.isnan(found.cells)


def test_a_place_that_shows_nothing_is_refused() -> None:
    with pytest.raises(BadInput, match="nothing of the mesh"):
        Texels(table(np.full((SIDE, SIDE, 3), 0.5))).spread_at(camera(position=(9.0, 9.0, 5.0)), 0.5, 0.5, 1.0)
