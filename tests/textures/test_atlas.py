"""The atlas: own texels for every face, the wanted density, lookups that agree, holes that fill."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay

from iris_addon.capture.mesh_files import uv_overlap
from iris_addon.model.capture import DEGENERATE_AREA, Mesh
from iris_addon.textures.atlas import covered_texels, interpolate_uv, rasterise_atlas, texel_index
from iris_addon.textures.charts import UNSEEN_SHARE, build_atlas
from iris_addon.textures.fill import fill_texels
from iris_addon.textures.texel_density import (
    SIDE_STEP,
    TEXELS_PER_PIXEL,
    resolved_side,
    texel_density_from_footprint,
)
from tests.box_room import box_mesh

SIZE = 256


def joined(*meshes: trimesh.Trimesh | Mesh) -> Mesh:
    """One mesh of several; faces in order."""
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = [np.asarray(mesh.faces, np.int64) + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([np.asarray(mesh.vertices, float) for mesh in meshes]), np.concatenate(faces))


def furnished_room() -> Mesh:
    """Walls, a sphere, a cylinder and a torus: flat, round and hollow."""
    return joined(
        box_mesh(),
        trimesh.creation.icosphere(subdivisions=3, radius=0.4).apply_translation([1, 1, 1]),
        trimesh.creation.cylinder(radius=0.2, height=1.0, sections=40).apply_translation([3, 1, 1]),
        trimesh.creation.torus(0.5, 0.15).apply_translation([2, 2, 1]),
    )


def spiral_ramp(turns: float = 2.5, steps: int = 120) -> Mesh:
    """A ramp whose projection from above covers itself more than twice although it folds nowhere."""
    angle = np.linspace(0, 2 * np.pi * turns, steps)
    rail = [np.stack([r * np.cos(angle), r * np.sin(angle), 0.1 * angle], 1) for r in (1.0, 2.0)]
    inner = np.arange(steps - 1)
    outer = inner + steps
    faces = np.concatenate([np.stack([inner, outer, outer + 1], 1), np.stack([inner, outer + 1, inner + 1], 1)])
    return Mesh(np.concatenate(rail), faces)


def triangle_soup(count: int) -> Mesh:
    """Loose triangles of about 2 cm in a cube of one metre."""
    rng = np.random.default_rng(1)
    corners = rng.random((count, 1, 3)) + 0.02 * rng.standard_normal((count, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))


def areas_of(corners: np.ndarray) -> np.ndarray:
    """(F,) areas of triangles (F, 3, 2 or 3)."""
    solid = np.concatenate([corners, np.zeros((*corners.shape[:2], 3 - corners.shape[2]))], 2).astype(float)
    return 0.5 * np.linalg.norm(np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0]), axis=1)


def density_of(uv: np.ndarray, mesh: Mesh, size: int = SIZE) -> np.ndarray:
    """(F,) texels per metre that an atlas gives to each face."""
    return np.sqrt(areas_of(uv) / areas_of(mesh.vertices[mesh.faces])) * size


@pytest.mark.parametrize("mesh", [box_mesh(), furnished_room(), spiral_ramp()], ids=["box", "furnished", "spiral"])
def test_faces_have_their_own_place_inside_the_atlas(mesh: Mesh) -> None:
    uv = build_atlas(mesh, np.full(len(mesh.faces), 100.0), SIZE)
    assert uv.shape == (len(mesh.faces), 3, 2)
    assert uv.min() >= 0
    assert uv.max() <= 1
    assert (areas_of(uv) > 0).all()
    assert uv_overlap(uv, side=1000) < 0.002
    assert areas_of(uv).sum() > 0.4


def test_charts_do_not_bleed_through_linear_filtering() -> None:
    """The four texels that a linear filter reads anywhere on a face never show a face of another wall."""
    mesh = box_mesh()
    uv = build_atlas(mesh, np.full(12, 100.0), SIZE)
    face, _ = rasterise_atlas(uv, SIZE)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet([0.3, 0.3, 0.3], size=(12, 4000))  # many points close to edges and corners
    points = np.einsum("fnc,fck->fnk", weights, uv)
    for step in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        texel = np.floor(np.array([points[..., 0], 1 - points[..., 1]]) * SIZE + np.reshape(step, (2, 1, 1)))
        column, row = np.clip(texel, 0, SIZE - 1).astype(int)
        shown = face[row, column]
        assert ((shown < 0) | (shown // 2 == np.arange(12)[:, None] // 2)).all()


def test_density_is_the_wanted_one_up_to_one_factor() -> None:
    mesh = joined(*(trimesh.creation.box([1, 1, 1]).apply_translation([2 * k, 0, 0]) for k in range(4)))
    wanted = np.repeat([50.0, 100.0, 200.0, 0.0], 12)
    ratio = density_of(build_atlas(mesh, wanted, SIZE), mesh) / np.repeat([50, 100, 200, UNSEEN_SHARE * 100], 12)
    assert np.allclose(ratio, ratio[0], rtol=1e-3)


def test_a_face_longer_than_the_atlas_does_not_starve_the_others() -> None:
    wire = trimesh.creation.box([500.0, 0.01, 0.01])
    mesh = joined(box_mesh(), wire)
    density = density_of(build_atlas(mesh, np.full(len(mesh.faces), 100.0), SIZE), mesh)
    alone = density_of(build_atlas(box_mesh(), np.full(12, 100.0), SIZE), box_mesh())
    assert density[:12].min() > 0.8 * alone.min()


@pytest.mark.parametrize("wanted_outside", [0.0, 100.0])
def test_a_vast_ground_plane_leaves_room_for_the_house(wanted_outside: float) -> None:
    ground = Mesh(1000 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    mesh = joined(box_mesh(), ground)
    uv = build_atlas(mesh, np.concatenate([np.full(12, 100.0), np.full(2, wanted_outside)]), SIZE)
    assert areas_of(uv)[:12].sum() > 0.3


def test_degenerate_faces_are_tolerated() -> None:
    room = box_mesh()
    needle = np.array([[0, 0, 0], [1, 1, 1]]), np.array([[0, 1, 1], [0, 0, 0], [0, 1, 0]])
    mesh = joined(room, Mesh(*needle), spiral_ramp())
    uv = build_atlas(mesh, np.full(len(mesh.faces), 100.0), SIZE)
    degenerate = areas_of(mesh.vertices[mesh.faces]) <= DEGENERATE_AREA
    assert degenerate.sum() == 3
    assert np.isfinite(uv).all()
    assert (areas_of(uv)[degenerate] == 0).all()
    assert (areas_of(uv)[~degenerate] > 0).all()


def test_doubled_faces_get_a_place_each() -> None:
    room = box_mesh()
    mesh = Mesh(room.vertices, np.concatenate([room.faces, room.faces]))
    assert uv_overlap(build_atlas(mesh, np.full(24, 100.0), SIZE), side=1000) < 0.002


@pytest.mark.parametrize("count", [300, 20_000])
def test_a_mesh_of_loose_triangles_fits(count: int) -> None:
    mesh = triangle_soup(count)
    uv = build_atlas(mesh, np.ones(count), 128)
    assert uv.min() >= 0
    assert uv.max() <= 1
    assert (areas_of(uv) > 0).all()


@pytest.mark.parametrize("seen", [1, 2, 3, 4, 5])
def test_photos_of_a_few_faces_leave_room_for_all(seen: int) -> None:
    uv = build_atlas(box_mesh(), np.where(np.arange(12) < seen, 100.0, 0.0), SIZE)
    assert np.isfinite(uv).all() and (areas_of(uv) > 0).all()
    assert areas_of(uv)[:seen].sum() > 0.2


def test_an_unseen_mesh_is_laid_out_all_the_same() -> None:
    uv = build_atlas(box_mesh(), np.zeros(12), SIZE)
    assert areas_of(uv).sum() > 0.4


def test_rasterised_texels_are_the_ones_looked_up() -> None:
    mesh = furnished_room()
    uv = build_atlas(mesh, np.full(len(mesh.faces), 100.0), SIZE)
    face, barycentric = rasterise_atlas(uv, SIZE)
    shown = np.flatnonzero(face.ravel() >= 0)
    found = texel_index(uv, face.ravel()[shown], barycentric.reshape(-1, 2)[shown], SIZE)
    assert np.array_equal(found, shown)
    assert len(shown) / SIZE**2 == pytest.approx(areas_of(uv).sum(), rel=0.05)


def test_triangles_that_share_edges_cover_every_texel_once() -> None:
    rng = np.random.default_rng(3)
    border = np.linspace(-0.2, 1.2, 8)
    points = np.concatenate(
        [
            rng.random((200, 2)),
            *(np.column_stack(p) for e in (-0.2, 1.2) for p in ((border, 0 * border + e), (0 * border + e, border))),
        ]
    )
    uv = points[Delaunay(points).simplices].astype(np.float32)
    size = 97
    covered = covered_texels(uv, size)
    assert np.array_equal(np.sort(covered.texel), np.arange(size * size))
    at = interpolate_uv(uv, covered.face, covered.barycentric)
    centres = np.column_stack([covered.texel % size + 0.5, size - 0.5 - covered.texel // size]) / size
    assert np.abs(at - centres).max() < 1e-5


def test_triangles_without_texels_or_area_cover_nothing() -> None:
    uv = np.array([[[0.5, 0.5]] * 3, [[0, 0.3], [1, 0.3], [0.5, 0.3]], [[1.1, 0], [1.3, 0], [1.2, 1]]], np.float32)
    assert len(covered_texels(uv, 64).face) == 0


def test_a_texel_under_two_faces_is_reported_twice() -> None:
    square = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], np.float32)
    covered = covered_texels(np.concatenate([square, square]), 8)
    assert (np.bincount(covered.texel) == 2).all()


def test_row_zero_is_the_top() -> None:
    uv = np.array([[[0, 1], [0, 0.5], [0.5, 1]]], np.float32)
    assert texel_index(uv, np.array([0, 0]), np.array([[0, 0], [0.9, 0]], np.float32), 4).tolist() == [0, 4]
    face, _ = rasterise_atlas(uv, 4)
    assert (face[:2, :2] == 0).sum() >= 1
    assert (face[2:] == -1).all()


def test_density_follows_the_near_photos() -> None:
    face = np.repeat([0, 2], 100)
    footprint = np.concatenate([np.linspace(0.01, 0.05, 100), np.full(100, 0.01)]).astype(np.float32)
    density = texel_density_from_footprint(face, footprint, 4)
    assert density[0] == pytest.approx(1 / 0.02, rel=0.02)
    assert density[2] == pytest.approx(100)
    assert density[1] == density[3] == 0


def test_one_pixel_next_to_a_camera_does_not_take_the_atlas() -> None:
    density = texel_density_from_footprint(np.array([0, 1, 2]), np.array([1e-6, 0.01, 0.01], np.float32), 3)
    assert density.max() / density.min() <= 10


def test_an_atlas_has_the_texels_that_photos_resolve() -> None:
    """Twice as many pixels a metre need twice the side."""
    mesh, density = box_mesh(), np.full(12, 200.0)
    side = resolved_side(mesh, density)
    assert resolved_side(mesh, 2 * density) == pytest.approx(2 * side, abs=SIDE_STEP)
    uv = build_atlas(mesh, density, side)
    on_atlas = 0.5 * np.abs(np.cross(uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]))
    corners = mesh.vertices[mesh.faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    texels = np.sqrt(on_atlas * side**2 / areas)
    assert texels.min() > TEXELS_PER_PIXEL * 200 * 0.9 and texels.max() < TEXELS_PER_PIXEL * 200 * 1.3
    # Its own texture coordinates, which cover a quarter of the square, need twice the side.
    own = resolved_side(mesh.with_uv(uv), density)
    assert own == pytest.approx(side, abs=SIDE_STEP)
    assert resolved_side(mesh.with_uv(uv / 2), density) == pytest.approx(2 * own, abs=SIDE_STEP)
    assert resolved_side(mesh, np.zeros(12)) == SIDE_STEP, "photos that show nothing"


@pytest.mark.parametrize("size", [64, 100])
def test_holes_of_a_constant_fill_with_it(size: int) -> None:
    known = np.random.default_rng(0).random((size, size)) < 0.01
    colour = np.array([0.2, 0.5, 0.7], np.float32)
    filled = fill_texels(np.where(known[..., None], colour, 99.0), known)
    assert filled.dtype == np.float32
    assert np.allclose(filled, colour, atol=1e-6)


def test_known_texels_stay_and_holes_lie_between() -> None:
    ramp = np.broadcast_to(np.linspace(0, 1, 64, dtype=np.float32), (64, 64))
    known = np.ones((64, 64), bool)
    known[20:44, 20:44] = False
    filled = fill_texels(ramp, known)
    assert filled.shape == (64, 64)
    assert np.array_equal(filled[known], ramp[known])
    assert np.abs(filled - ramp).max() < 0.12


def test_nothing_known_gives_zeros() -> None:
    assert not fill_texels(np.ones((16, 16, 3)), np.zeros((16, 16), bool)).any()


# Most charts of a scan are smaller than their room in between.
@pytest.mark.parametrize(("name", "filled"), [("staircase2/scene.ply", 0.4), ("redkitchen/mesh.ply", 0.28)])
def test_real_rooms_fill_the_atlas_without_overlap(shared: Path, name: str, filled: float) -> None:
    read = trimesh.load(shared / "captures" / name, process=False)
    mesh = Mesh(np.asarray(read.vertices, float), np.asarray(read.faces, np.int64))
    uv = build_atlas(mesh, np.full(len(mesh.faces), 100.0), 1024)
    area = areas_of(mesh.vertices[mesh.faces])
    assert uv_overlap(uv, side=1024) < 0.001
    assert area[areas_of(uv) == 0].sum() < 1e-5 * area.sum()  # slivers at right angles to their chart
    assert areas_of(uv).sum() > filled
