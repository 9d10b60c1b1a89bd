"""Regions of finely cut models and of scans."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from iris_addon.model.capture import Mesh
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples
from iris_addon.surface.regions import split_regions
from iris_addon.surface.scan_surface import SCAN_MIN_FACES, surface_behind

SIDE = 110
assert 2 * (SIDE - 1) ** 2 > SCAN_MIN_FACES


def _sheet(roughness: float) -> Mesh:
    """A square metre of many triangles, folded upright at half its length, its vertices off by ``roughness``."""
    x, y = np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE), indexing="ij")
    vertices = np.stack([np.minimum(x, 0.5), y, np.maximum(x - 0.5, 0)], -1).reshape(-1, 3)
    vertices += np.random.default_rng(0).normal(0, roughness, vertices.shape)
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    faces = np.concatenate([np.c_[a, b, c], np.c_[a, c, d]])
    return Mesh(vertices, faces)


def _seen(mesh: Mesh) -> tuple[PixelSamples, NDArray[np.float32]]:
    """Two pixels per face of a photo of stripes: dark for y < 0.5, light beyond, with noise."""
    tracer = Tracer(mesh)
    face = np.repeat(np.arange(len(mesh.faces), dtype=np.int32), 2)
    n = len(face)
    center = mesh.vertices[mesh.faces].mean(1)[face].astype(np.float32)
    column = np.zeros(n, np.float32)
    normal = tracer.normals[face].astype(np.float32)
    third = np.full((n, 2), 1 / 3, np.float32)
    samples = PixelSamples(
        view=np.zeros(n, np.int16),
        pixel=np.arange(n, dtype=np.int32),
        face=face,
        barycentric=third,
        position=center,
        normal=normal,
        direction=normal,
        footprint=column + 0.01,
    )
    level = np.where(center[:, 1] < 0.5, 0.2, 0.7)[:, None]
    z = level * np.random.default_rng(1).normal(1, 0.02, (n, 3))
    return samples, z.astype(np.float32)


@pytest.mark.parametrize("roughness", [0.0, 0.0015])
def test_a_model_is_split_at_its_folds_and_a_scan_at_its_colours_too(roughness: float):
    mesh = _sheet(roughness)
    samples, z = _seen(mesh)
    regions, scanned, in_file = split_regions(mesh, surface_behind(mesh), samples, z)
    assert (scanned == (roughness > 0)).all() and in_file is None
    center = mesh.vertices[mesh.faces].mean(1)
    upright, light = center[:, 2] > 0.005, center[:, 1] > 0.5
    assert _purity(regions, upright) > 0.97
    assert _purity(regions, light) < 0.6 if roughness == 0 else _purity(regions, light) > 0.97


def test_a_scan_is_split_within_the_pages_of_its_texture():
    mesh = _sheet(0.0015)
    center = mesh.vertices[mesh.faces].mean(1)
    page, light = (center[:, 0] > 0.25).astype(np.int32), center[:, 1] > 0.5
    paged = Mesh(mesh.vertices, mesh.faces, regions=page)
    samples, z = _seen(mesh)
    regions, scanned, in_file = split_regions(paged, surface_behind(paged), samples, z)
    assert scanned.all() and _purity(regions, light) > 0.97 and _purity(regions, page == 1) == 1
    assert in_file is not None and np.array_equal(in_file[regions], page)
    flat = _sheet(0.0)
    modelled = Mesh(flat.vertices, flat.faces, regions=page)
    regions, scanned, in_file = split_regions(modelled, surface_behind(modelled), *_seen(flat))
    assert not scanned.any() and in_file is not None and np.array_equal(in_file[regions], page)
    upright = flat.vertices[flat.faces].mean(1)[:, 2] > 0.005
    assert _purity(regions, upright) > 0.97, "one of the pages is folded"


def test_regions_of_the_file_are_split_into_components():
    """Two sheets a metre apart that the capture calls one region, and one that it calls two."""
    sheet = _sheet(0.0)
    n, faces = len(sheet.vertices), len(sheet.faces)
    third = sheet.vertices[sheet.faces].mean(1)[:, 1] > 0.5
    mesh = Mesh(
        np.concatenate([sheet.vertices + [0, 2 * k, 0] for k in range(3)]),
        np.concatenate([sheet.faces + k * n for k in range(3)]),
        regions=np.concatenate([np.zeros(2 * faces), 1 + third]).astype(np.int32),
    )
    samples, z = _seen(mesh)
    unseen = samples.take(np.flatnonzero(samples.face < 10))  # no piece between folds is large in the photos
    split = split_regions(mesh, surface_behind(mesh), unseen, z[: len(unseen.face)])
    assert mesh.regions is not None and split.in_file is not None
    assert np.array_equal(split.in_file[split.of_face], mesh.regions)
    sheets = np.repeat(np.arange(3), faces)
    assert len(np.unique(split.of_face[sheets < 2])) >= 2
    assert not np.isin(split.of_face[sheets == 0], split.of_face[sheets == 1]).any()
    assert len(np.unique(split.of_face[sheets == 2])) == 2


ROUND = np.arange(0, 91, 6)


def _tower(half: float, radius: float) -> Mesh:
    """Four walls of 2.5 m around a square of ``half`` its side, joined by quarter circles of ``radius`` in steps of six
    degrees, none of which is a sharp edge."""
    arc = radius * np.stack([np.cos(np.radians(ROUND)) - 1, np.sin(np.radians(ROUND)) - 1], 1)
    corners = [half + arc]
    for _ in range(3):
        corners.append(np.stack([-corners[-1][:, 1], corners[-1][:, 0]], 1))
    outline = np.concatenate(corners)
    n = len(outline)
    low, after = np.arange(n), (np.arange(n) + 1) % n
    vertices = np.concatenate([np.c_[outline, np.full(n, height)] for height in (0.0, 2.5)])
    return Mesh(vertices, np.concatenate([np.c_[low, after, after + n], np.c_[low, after + n, low + n]]))


def _split(mesh: Mesh) -> NDArray[np.int32]:
    """Regions of a mesh that photos show with as many pixels as each face has of its area."""
    samples, z = _seen(mesh)
    area = Tracer(mesh).areas[samples.face]
    pixels = np.repeat(np.arange(len(samples.face)), np.maximum(1, 20_000 * area / area.sum()).astype(int))
    return split_regions(mesh, surface_behind(mesh), samples.take(pixels), z[pixels]).of_face


@pytest.mark.parametrize(
    ("half", "radius", "walls"), [(1.0, 0.025, 4), (1.0, 0.035, 1), (0.4, 0.4, 1), (0.025, 0.025, 1)]
)
def test_walls_between_rounded_edges_are_regions_and_neither_a_round_tower_nor_a_pipe_is_split(
    half: float, radius: float, walls: int
):
    regions = _split(_tower(half, radius))
    n, side = len(regions) // 2, len(ROUND)
    flat = np.arange(1, 5) * side - 1
    assert len(np.unique(regions[flat])) == walls
    assert np.array_equal(regions[flat], regions[flat + n]), "both triangles of a wall"
    assert walls > 1 or len(np.unique(regions)) == 1


def test_how_faces_are_wound_splits_no_wall():
    for mesh in (_tower(1.0, 0.01), _sheet(0.0)):
        flipped = mesh.faces.copy()
        flipped[::3] = flipped[::3, ::-1]
        split = _split(mesh)
        assert len(np.unique(split)) > 1 and np.array_equal(_split(Mesh(mesh.vertices, flipped)), split)


def _purity(regions: NDArray[np.integer], side: NDArray[np.bool_]) -> float:
    """Share of the faces that lie on the side on which most of their region does."""
    return float(np.maximum(np.bincount(regions, side), np.bincount(regions, ~side)).sum() / len(regions))
