"""Textures of the size that was asked for: side, density, what a mesh's own coordinates keep, what does not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.base.progress import Progress
from iris_addon.capture.mesh_files import face_areas, uv_overlap
from iris_addon.config import SolveConfig, preset
from iris_addon.model.capture import Mesh
from iris_addon.model.texture_size import AskedSize, blender_bytes, in_blender
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.textures.atlas import Atlas, plane_areas
from iris_addon.textures.charts import UNSEEN_SHARE, atlas_for_photos, build_atlas, build_even_atlas
from iris_addon.textures.texel_density import density_warnings, describe_atlas
from tests.engine_room import cameras, furnished_room

ROOM = furnished_room(np.inf).mesh
PHOTOS = cameras(12, 64, 48)


@pytest.fixture(scope="module")
def samples() -> PixelSamples:
    return trace_pixels(Tracer(ROOM), PHOTOS, Progress())


def atlas_of(mesh: Mesh, samples: PixelSamples, **asked: object) -> Atlas:
    return atlas_for_photos(mesh, samples, np.ones(len(PHOTOS), int), preset("final", **asked).texture_size)


def densities(mesh: Mesh, atlas: Atlas) -> np.ndarray:
    """(F,) texels per metre, by area in the image over area in space."""
    return np.sqrt(plane_areas(atlas.uv.astype(float)) / face_areas(mesh)) * atlas.size


def seen(samples: PixelSamples) -> np.ndarray:
    return samples.seen_faces(len(ROOM.faces))


@pytest.mark.parametrize("asked", [15, 40, 90])
def test_every_face_that_photos_see_has_the_density_asked_for(samples: PixelSamples, asked: float) -> None:
    atlas = atlas_of(ROOM, samples, texels_per_metre=asked)
    reached = densities(ROOM, atlas)
    assert seen(samples).sum() > 20
    np.testing.assert_allclose(reached[seen(samples)], asked, rtol=0.02)
    assert describe_atlas(ROOM.with_uv(atlas.uv), atlas, samples)["texels_per_metre"] == pytest.approx(asked, rel=0.02)
    assert uv_overlap(atlas.uv, side=1000) < 0.002
    # No larger than it must be; small charts need room in between.
    assert plane_areas(atlas.uv.astype(float)).sum() > 0.5
    rows, columns = np.divmod(atlas.texel, atlas.size)
    assert rows.max() < atlas.size and columns.max() < atlas.size


def test_faces_no_photo_shows_take_fewer_texels(samples: PixelSamples) -> None:
    shown = np.ones(len(ROOM.faces), bool)
    shown[ROOM.regions == 5] = False
    uv, side = build_even_atlas(ROOM, shown, 40.0, 4096)
    reached = np.sqrt(plane_areas(uv.astype(float)) / face_areas(ROOM)) * side
    np.testing.assert_allclose(reached[~shown], UNSEEN_SHARE * 40, rtol=0.02)
    np.testing.assert_allclose(reached[shown], 40, rtol=0.02)


@pytest.mark.parametrize("preset_name", ["draft", "final"])
@pytest.mark.parametrize("side", [256, 2048])
def test_a_side_that_is_asked_for_is_that_of_the_atlas(samples: PixelSamples, preset_name: str, side: int) -> None:
    atlas = atlas_for_photos(
        ROOM, samples, np.ones(len(PHOTOS), int), preset(preset_name, atlas_size=side).texture_size
    )
    assert atlas.size == side
    assert plane_areas(atlas.uv.astype(float)).sum() > 0.5  # the charts fill it
    assert atlas_of(ROOM, samples).size < 1024  # photos of 64 x 48 pixels resolve less than the preset allows


@pytest.mark.parametrize("asked", [30, 77])
def test_a_mesh_with_texture_coordinates_keeps_them_at_the_mean_density(samples: PixelSamples, asked: float) -> None:
    wanted = np.where(ROOM.regions < 6, 50.0, 150.0)  # of two densities
    own = ROOM.with_uv(build_atlas(ROOM, wanted, 512) / 2)
    atlas = atlas_of(own, samples, texels_per_metre=asked)
    assert np.array_equal(atlas.uv, own.uv)
    shown, area = seen(samples), face_areas(own)
    mean = np.sqrt((densities(own, atlas) ** 2 * area)[shown].sum() / area[shown].sum())
    assert mean == pytest.approx(asked, rel=0.03)
    fixed = atlas_of(own, samples, atlas_size=256)
    assert fixed.size == 256 and np.array_equal(fixed.uv, own.uv)


@pytest.mark.parametrize("own", [False, True])
def test_a_density_that_does_not_fit_is_cut_and_said(samples: PixelSamples, own: bool) -> None:
    mesh = ROOM.with_uv(build_atlas(ROOM, np.full(len(ROOM.faces), 50.0), 512)) if own else ROOM
    asked = preset("draft", texels_per_metre=200, atlas_size=256).texture_size
    atlas = atlas_for_photos(mesh, samples, np.ones(len(PHOTOS), int), asked)
    reached = describe_atlas(mesh.with_uv(atlas.uv), atlas, samples)
    assert reached["side"] == 256 and reached["bytes_in_blender"] == blender_bytes(256)
    measured = densities(mesh, atlas)[seen(samples)]
    assert measured.min() > 0.9 * reached["texels_per_metre"] and measured.max() < 1.1 * reached["texels_per_metre"]
    (warning,) = density_warnings(reached, asked)
    assert f"{reached['texels_per_metre']:.3g} texels per metre" in warning and "200" in warning
    # The size it names does hold them.
    needed = int(warning.split("an atlas size of ")[1].split()[0])
    larger = atlas_of(mesh, samples, texels_per_metre=200, atlas_size=needed)
    enough = describe_atlas(mesh.with_uv(larger.uv), larger, samples)
    assert not density_warnings(enough, AskedSize(needed, None, 200.0))
    assert enough["texels_per_metre"] == pytest.approx(200, rel=0.05)


def test_a_corridor_longer_than_its_atlas_would_be_gets_its_density(samples: PixelSamples) -> None:
    strip = Mesh(np.array([[0, 0, 0], [40, 0, 0], [40, 0.5, 0], [0, 0.5, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    uv, side = build_even_atlas(strip, np.ones(2, bool), 10.0, 1024)
    np.testing.assert_allclose(np.sqrt(plane_areas(uv.astype(float)) / face_areas(strip)) * side, 10, rtol=0.02)
    assert side < 450
    cut, most = build_even_atlas(strip, np.ones(2, bool), 10.0, 256)
    assert most == 256 and cut.max() <= 1 and plane_areas(cut.astype(float)).min() > 0


def test_a_mesh_without_area_is_laid_out_all_the_same() -> None:
    nothing = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    uv, side = build_even_atlas(nothing, np.zeros(1, bool), 10.0, 1024)
    assert not uv.any() and side <= 1024


# What may be asked for -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "asked",
    [
        {"atlas_size": value}
        for value in (0, 128, 1000, 32768, -1024, 1024.5, True, None, "", "large", float("inf"), 10**400)
    ]
    + [{"texels_per_metre": value} for value in (0, -1, 0.001, 1e9, float("nan"), float("inf"), "dense", None, [])],
)
def test_sizes_that_cannot_be_are_refused_by_name(asked: dict[str, object]) -> None:
    with pytest.raises(BadInput) as caught:
        preset("draft", **asked)
    assert next(iter(asked)) in str(caught.value) and "auto" in str(caught.value) and "\n" not in str(caught.value)


def test_what_may_be_asked_for_is_one_value_however_it_is_written() -> None:
    assert preset("draft", atlas_size="2048", texels_per_metre="50") == preset(
        "draft", atlas_size=2048, texels_per_metre=50.0
    )
    assert preset("draft", atlas_size="auto") == preset("draft")
    for side in (256, 16384):
        assert replace(SolveConfig(), atlas_size=side).texture_size == AskedSize(side, side, None)
    assert preset("final", texels_per_metre=5).texture_size == AskedSize(4096, None, 5.0)


def test_memory_is_said_in_one_line() -> None:
    assert in_blender(4096) == "4096 x 4096, 0.5 GB" and in_blender(512) == "512 x 512, 7 MB"
