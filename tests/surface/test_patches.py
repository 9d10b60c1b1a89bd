"""Patches: what lies together, faces one way and belongs to one region, whatever the triangles are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from iris_addon.base.progress import Progress
from iris_addon.model.capture import Mesh, View
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.patches import Surface, build_surface, normal_spread
from iris_addon.surface.photo_samples import within_budget
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.surface.topology import edge_adjacency, initial_regions
from tests.engine_room import Room, assemble, box, cameras, furnished_room, quad


def surface_of(room: Room, max_patches: int = 4000) -> tuple[PixelSamples, Surface]:
    samples = trace_pixels(Tracer(room.mesh), cameras(), Progress())
    return samples, build_surface(room.mesh, samples, room.regions, max_patches, np.random.default_rng(0))


@pytest.fixture(scope="module")
def room() -> Room:
    return furnished_room(np.inf)


@pytest.fixture(scope="module")
def patched(room: Room) -> tuple[PixelSamples, Surface]:
    return surface_of(room)


def test_every_pixel_finds_its_own_patch(room: Room, patched: tuple[PixelSamples, Surface]) -> None:
    samples, surface = patched
    found = surface.grid.patches(samples.position, samples.normal, room.regions[samples.face])
    assert (found == surface.sample_patch).all()
    assert (np.bincount(surface.sample_patch) == surface.count).all()


def test_points_off_the_seen_surface_have_no_patch(patched: tuple[PixelSamples, Surface]) -> None:
    samples, surface = patched
    region = surface.region[surface.sample_patch]
    assert (surface.grid.patches(samples.position + 50, samples.normal, region) == -1).all()
    assert (surface.grid.patches(samples.position, samples.normal, region + 100) == -1).all()
    # The far side of a wall is another surface.
    assert (surface.grid.patches(samples.position, -samples.normal, region) == -1).mean() > 0.99


def test_patches_mix_neither_regions_nor_orientations(room: Room, patched: tuple[PixelSamples, Surface]) -> None:
    samples, surface = patched
    assert (room.regions[samples.face] == surface.region[surface.sample_patch]).all()
    assert ((samples.normal * surface.normal[surface.sample_patch]).sum(1) > 0.8).all()


def test_normals_spread_as_they_do_in_closed_form() -> None:
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((40_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    sheet = np.tile([[0.0, 0.6, 0.8]], (50, 1)) * np.where(np.arange(50) % 2, 1, -1)[:, None]
    edge = np.eye(3)[np.arange(60) % 2]
    group = np.repeat([0, 1, 2], [len(ball), len(sheet), len(edge)])
    spread = normal_spread(np.concatenate([ball, sheet, edge]), group)
    assert spread == pytest.approx([np.sqrt(2 / 3), 0.0, np.sqrt(1 / 2)], abs=0.01)


def test_normal_spread_is_zero_on_flat_walls_and_positive_on_noisy_ones(patched: tuple[PixelSamples, Surface]) -> None:
    _, surface = patched
    wall = surface.region < 6
    assert surface.spread[wall].max() < 1e-3
    fine = furnished_room(0.08)
    moved = fine.mesh.vertices + np.random.default_rng(0).normal(0, 0.01, fine.mesh.vertices.shape)
    _, shaken = surface_of(replace(fine, mesh=replace(fine.mesh, vertices=moved)))
    assert np.median(shaken.spread[shaken.region < 6]) > 0.15


def test_a_thin_board_has_two_sides() -> None:
    board = quad([2, 1, 0.5], [0, 1, 0], [0, 0, 1.2])
    room = Room(assemble([*box([0, 0, 0], [4, 3, 2.5]), board], [0] * 7), np.ones((1, 3)), np.zeros((1, 3)))
    samples, surface = surface_of(room)
    on_board = np.flatnonzero(samples.face >= 12)
    left = samples.normal[on_board, 0] < 0
    assert 0 < left.mean() < 1
    patch = surface.sample_patch[on_board]
    assert not np.intersect1d(patch[left], patch[~left]).size


def test_origins_lie_on_their_patch(patched: tuple[PixelSamples, Surface]) -> None:
    _, surface = patched
    reach = np.linalg.norm(surface.origins.position - surface.position[:, None], axis=2)
    assert (reach < 0.01 * 2**6).all()
    region = np.repeat(surface.region, surface.origins.position.shape[1])
    found = surface.grid.patches(surface.origins.position.reshape(-1, 3), surface.origins.normal.reshape(-1, 3), region)
    assert (found.reshape(len(surface.region), -1) == np.arange(len(surface.region))[:, None]).all()


@pytest.mark.parametrize("budget", [100, 700, 3000])
def test_the_budget_of_patches_holds(room: Room, budget: int) -> None:
    _, surface = surface_of(room, budget)
    assert 0.2 * budget < len(surface.region) <= budget


def test_an_over_dense_mesh_gives_the_same_patches(room: Room, patched: tuple[PixelSamples, Surface]) -> None:
    vertices, faces, index = room.mesh.vertices, room.mesh.faces, np.arange(len(room.mesh.faces))
    for _ in range(4):
        vertices, faces, children = trimesh.remesh.subdivide(vertices, faces, return_index=True)
        origin = np.empty(len(faces), np.int64)
        for parent, rows in children.items():
            origin[rows] = index[parent]
        index = origin
    dense = replace(room, mesh=Mesh(vertices, faces.astype(np.int64), None, room.regions[index]))
    assert len(dense.mesh.faces) == 256 * len(room.mesh.faces)
    samples, surface = patched
    dense_samples, dense_surface = surface_of(dense)
    assert len(dense_samples.view) == len(samples.view)
    shared = np.isin(dense_surface.grid.cell_keys, surface.grid.cell_keys).mean()
    assert shared > 0.98
    assert len(dense_surface.region) == pytest.approx(len(surface.region), rel=0.01)


def test_patches_do_not_depend_on_the_unit_of_length(room: Room, patched: tuple[PixelSamples, Surface]) -> None:
    """A capture in centimetres (hundreds of units wide) is cut like the same room in metres, not into specks."""
    samples = trace_pixels(Tracer(room.mesh), cameras(), Progress())
    scaled = replace(samples, position=samples.position * 1000, footprint=samples.footprint * 1000)
    mesh = replace(room.mesh, vertices=room.mesh.vertices * 1000)
    surface = build_surface(mesh, scaled, room.regions, 4000, np.random.default_rng(0))
    assert 500 < len(surface.region) <= 4000


def test_a_far_backdrop_leaves_the_room_its_patches(room: Room, patched: tuple[PixelSamples, Surface]) -> None:
    samples, surface = patched
    far = np.array([[-1e3, 1e3, -1e3], [1e3, 1e3, -1e3], [0, 1e3, 1e3]])
    n = len(room.mesh.vertices)
    both = Mesh(np.vstack([room.mesh.vertices, far]), np.vstack([room.mesh.faces, [[n, n + 1, n + 2]]]))
    beside = build_surface(both, samples, room.regions, 4000, np.random.default_rng(0))
    assert len(beside.region) == pytest.approx(len(surface.region), rel=0.1)


# Regions and pixels --------------------------------------------------------------------------------------------------


def test_regions_of_a_mesh_that_names_none_are_its_connected_components() -> None:
    mesh = assemble([*box([0, 0, 0], [1, 1, 1], 0.5), *box([2, 0, 0], [3, 1, 1], 0.5)], [0] * 12)
    regions = initial_regions(replace(mesh, regions=None))  # the sides of a box share no vertex, only places
    half = len(mesh.faces) // 2
    assert len(np.unique(regions)) == 2
    assert len(np.unique(regions[:half])) == 1 and regions[0] != regions[-1]


def test_faces_that_share_an_edge_are_neighbours() -> None:
    a, b = edge_adjacency(assemble([quad([0, 0, 0], [1, 0, 0], [0, 1, 0])], [0]))
    assert sorted([int(a[0]), int(b[0])]) == [0, 1] and len(a) == 1
    mesh = assemble(box([0, 0, 0], [1, 1, 1]), [0] * 6)
    a, _ = edge_adjacency(mesh)
    assert len(a) == 18  # a closed surface of 12 triangles has 18 edges
    far = replace(mesh, vertices=np.concatenate([mesh.vertices, [[1e7, 0, 0]]]))  # a point of no face
    assert np.array_equal(edge_adjacency(far)[0], a)


def test_photos_are_reduced_until_they_fit_the_budget() -> None:
    views = [View("a", cameras(1, 40, 30)[0], None)] * 8
    assert within_budget(views, 9600) == tuple(views)
    for budget in (9599, 2400):
        small = within_budget(views, budget)
        assert [(view.camera.width, view.camera.height, view.reduction) for view in small] == [(20, 15, 2)] * 8


def test_pixels_know_their_size_on_the_surface(patched: tuple[PixelSamples, Surface]) -> None:
    samples, _ = patched
    camera = cameras()[0]
    rows = np.flatnonzero(samples.view == 0)
    distance = np.linalg.norm(samples.position[rows] - camera.position, axis=1)
    assert samples.footprint[rows] == pytest.approx(distance / camera.fx, rel=1e-3)
    assert (samples.cosine > 0).all()
