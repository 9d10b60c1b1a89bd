"""Regions of a scan that a shadow split are one material; regions of two paints are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import iris_addon.surface.traced_room
from iris_addon.config import preset
from iris_addon.materials.rounds import MaterialProblem
from iris_addon.model.response import gamma
from iris_addon.pipeline import solve
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.regions import REJOIN_DIFFERENCE, REJOIN_STEP, Regions, joined_regions
from iris_addon.surface.topology import edge_adjacency
from tests.engine_room import SIZE, assemble, cameras, furnished_room, photograph, quad, render

WIDTH, CELL = 0.5, 0.05
STRIPS = 6
MESH = assemble([quad([k * WIDTH, 0, 0], [WIDTH, 0, 0], [0, 0.6, 0], CELL) for k in range(STRIPS)], list(range(STRIPS)))
"""A wall of strips side by side, each a region of its own."""
assert MESH.regions is not None
REGIONS = MESH.regions
ADJACENCY = edge_adjacency(MESH)
SCANNED = np.ones(len(REGIONS), bool)
PIXELS = np.full(len(REGIONS), 9)
ONE_PIECE = np.zeros(len(REGIONS), np.int32)
MIDDLE = MESH.vertices[MESH.faces].mean(1)


def joined(
    log_albedo: np.ndarray,
    scanned: np.ndarray = SCANNED,
    pixels: np.ndarray = PIXELS,
    pieces: np.ndarray = ONE_PIECE,
) -> list[list[int]]:
    """Strips of each material, for log albedo (F,) alike in all channels."""
    label = joined_regions(REGIONS, ADJACENCY, log_albedo[:, None].repeat(3, 1), pixels, scanned, pieces)
    return sorted(np.flatnonzero(label == k).tolist() for k in np.unique(label))


def test_strips_of_one_paint_under_uneven_light_are_one_material() -> None:
    grain = np.random.default_rng(0).normal(0, 0.03, len(REGIONS))
    assert joined(np.log(0.4) + grain) == [list(range(STRIPS))]


@pytest.mark.parametrize(("step", "apart"), [(0.5 * REJOIN_STEP, False), (2 * REJOIN_STEP, True)])
def test_a_step_of_paint_keeps_both_sides_apart(step: float, apart: bool) -> None:
    found = joined(np.where(REGIONS < 2, 0.0, step) + np.log(0.3))
    assert found == ([[0, 1], [2, 3, 4, 5]] if apart else [list(range(STRIPS))])


def test_planks_that_differ_as_each_varies_are_one_floor() -> None:
    """Planks with a grain of 0.2 and as much between them; a white strip beside them is another material."""
    rng = np.random.default_rng(1)
    planks = np.append(rng.normal(0, 0.15, STRIPS - 1), 1.2)[REGIONS] + rng.normal(0, 0.2, len(REGIONS))
    assert joined(planks) == [list(range(STRIPS - 1)), [STRIPS - 1]]
    even = np.append(rng.normal(0, 0.15, STRIPS - 1), 1.2)[REGIONS]
    assert len(joined(even)) > 2, "strips of even paints are not planks"


def test_materials_end_where_the_surface_bends() -> None:
    assert joined(np.zeros(len(REGIONS)), pieces=REGIONS // 2) == [[0, 1], [2, 3], [4, 5]]


def test_a_few_faces_on_the_next_piece_lead_nowhere() -> None:
    """The last faces of each strip lie on the piece of the next."""
    strip = REGIONS + ((MIDDLE[:, 0] % WIDTH) > WIDTH - CELL)
    assert joined(np.zeros(len(REGIONS)), pieces=strip.astype(np.int32)) == [[k] for k in range(STRIPS)]


def test_a_step_in_one_channel_is_a_step() -> None:
    log_albedo = np.zeros((len(REGIONS), 3))
    log_albedo[REGIONS >= 3, 2] = 0.3
    label = joined_regions(REGIONS, ADJACENCY, log_albedo, PIXELS, SCANNED, ONE_PIECE)
    assert len(np.unique(label)) == 2 and label[2] != label[3]


def test_small_steps_do_not_add_up_to_another_paint() -> None:
    """Every strip is as bright as the next at their border, but the last is far from the first."""
    slope = 0.9 * REJOIN_DIFFERENCE / WIDTH
    found = joined(slope * MIDDLE[:, 0])
    assert len(found) > 1
    assert all(len(strips) <= 3 for strips in found)


def test_modelled_regions_stay_apart() -> None:
    found = joined(np.zeros(len(REGIONS)), scanned=REGIONS >= 3)
    assert found == [[0], [1], [2], [3, 4, 5]]


def test_a_border_that_no_photo_shows_joins_nothing() -> None:
    pixels = np.where(np.abs(MIDDLE[:, 0] - 3 * WIDTH) < 2 * CELL, 0, 9)
    assert joined(np.zeros(len(REGIONS)), pixels=pixels) == [[0, 1, 2], [3, 4, 5]]


def test_a_solve_joins_the_halves_of_a_scanned_wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve of a room of even walls: no paint steps where a region ends within a wall, all of it where walls meet."""
    room, views = furnished_room(), cameras(12, 48, 36)
    radiance = render(room, Tracer(room.mesh), views, 64)
    exposures = np.full(len(views), 0.25 / np.median(radiance.mean(-1)))
    capture = photograph(room, views, radiance, exposures, gamma(), tmp_path / "photos")
    halves = room.regions + len(room.albedo) * (room.mesh.vertices[room.mesh.faces].mean(1)[:, 0] > SIZE[0] / 2)
    split = np.unique(halves, return_inverse=True)[1].astype(np.int32)
    found = Regions(split, np.ones(len(split), bool), None)
    monkeypatch.setattr(iris_addon.surface.traced_room, "split_regions", lambda *_: found)
    joined_to: list[np.ndarray] = []
    with_materials = MaterialProblem.with_materials

    def watch(problem: MaterialProblem, material: np.ndarray) -> MaterialProblem:
        joined_to.append(material)
        return with_materials(problem, material)

    monkeypatch.setattr(MaterialProblem, "with_materials", watch)
    small = {"max_patches": 4000, "gather_rays": 64, "shadow_rays": 64, "max_atlas_size": 64, "rounds": 1}
    config = preset("draft", response="gamma", **small)
    result = solve(capture, config, tmp_path / "found")
    material = joined_to[-1][split]
    for region in (0, 1, 2, 3, 4, 5):
        assert len(np.unique(material[room.regions == region])) == 1
    # The ceiling is as white as one of the walls, but for the width of a step.
    assert len({int(material[room.regions == region][0]) for region in range(5)}) == 5
    model = result.report["model"]
    assert model["materials"] == len(np.unique(material)) < model["regions"] == split.max() + 1
