"""Which pixels lie on an edge, and what texels on an edge become."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, distance_transform_edt

from iris_addon.base.progress import Progress
from iris_addon.model.capture import Camera
from iris_addon.rays.tracer import Tracer
from iris_addon.response.observations import observe
from iris_addon.surface.mixed_pixels import beside_outlines, brighter_neighbours, mixed_pixels, off_edges
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from iris_addon.textures.bake import TexelAlbedo, UsualPixel, pixel_weight
from iris_addon.textures.principled import EXPECTED_WEIGHT, with_expected
from tests.box_room import look_at
from tests.engine_room import assemble, quad

WALL, TABLE = 0, 1


def photographed(quads: list, regions: list[int], width: int = 60) -> tuple[np.ndarray, Camera, PixelSamples]:
    """(F,) regions of the faces, the camera and its pixels, ``width`` a side, seen from 3 m along -z."""
    mesh = assemble(quads, regions)
    assert mesh.regions is not None
    camera = Camera(
        width=width,
        height=width,
        fx=width,
        fy=width,
        cx=width / 2,
        cy=width / 2,
        c2w=look_at(np.array([0, -1e-3, 3.0]), np.zeros(3)),
    )
    return mesh.regions, camera, trace_pixels(Tracer(mesh), [camera], Progress())


def mixed_picture(quads: list, regions: list[int], width: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) which pixels are mixed, and the region under each (-1 none)."""
    of_face, camera, samples = photographed(quads, regions, width)
    mixed, region = np.zeros((2, width, width), int)
    region -= 1
    mixed.flat[samples.pixel] = mixed_pixels(samples, of_face, [camera])
    region.flat[samples.pixel] = of_face[samples.face]
    return mixed > 0, region


def beside_another(region: np.ndarray) -> np.ndarray:
    """Pixels one of whose eight neighbours within the picture is of another region."""
    padded = np.pad(region, 1, mode="edge")
    h, w = region.shape
    return np.any([padded[i : i + h, j : j + w] != region for i in range(3) for j in range(3)], axis=0)


WIDE_WALL = quad([-3, -3, 0], [6, 0, 0], [0, 6, 0])


@pytest.mark.parametrize(("width", "pixels"), [(60, 4), (30, 2)])
def test_the_outline_of_a_scanned_thing_is_as_wide_as_it_may_be_off(width: int, pixels: int) -> None:
    """A table 1 m before a wall, 2 m from the camera, where 13 cm are four pixels or two; its fold is no outline."""
    table = quad([-0.5, -0.4, 1.0], [1, 0, 0], [0, 0.8, 0])
    mesh = assemble(
        [quad([-3, -3, 0], [6, 0, 0], [0, 5, 0]), quad([-3, 2, 0], [6, 0, 0], [0, 1, 0.5]), table], [0, 0, 1]
    )
    pose = look_at(np.array([0, -1e-3, 3.0]), np.zeros(3))
    camera = Camera(width=width, height=width, fx=width, fy=width, cx=width / 2, cy=width / 2, c2w=pose)
    samples = trace_pixels(Tracer(mesh), [camera], Progress())
    assert mesh.regions is not None
    on_table, found = np.zeros((2, width, width), bool)
    on_table.flat[samples.pixel] = mesh.regions[samples.face] == TABLE
    found.flat[samples.pixel] = beside_outlines(samples, [camera], 0.13)
    outside, inside = distance_transform_edt(~on_table), distance_transform_edt(on_table)
    assert found[(outside > 0) & (outside < pixels) | (inside > 0) & (inside < pixels)].all()
    assert not found[(outside > pixels + 1.5) | (inside > pixels + 1.5)].any()


@pytest.mark.parametrize("height", [0.5, 1e-4])
def test_pixels_around_the_outline_of_another_region_are_mixed_and_no_others(height: float) -> None:
    """A table before a wall, and a picture that lies almost in it."""
    mixed, region = mixed_picture([WIDE_WALL, quad([-0.5, -0.4, height], [1, 0, 0], [0, 0.8, 0])], [WALL, TABLE])
    assert (region == TABLE).sum() > 100 and (mixed == beside_another(region)).all()


def test_a_step_within_one_region_is_an_edge() -> None:
    mixed, _ = mixed_picture([WIDE_WALL, quad([-0.5, -0.4, 0.5], [1, 0, 0], [0, 0.8, 0])], [WALL, WALL])
    _, region = mixed_picture([WIDE_WALL, quad([-0.5, -0.4, 0.5], [1, 0, 0], [0, 0.8, 0])], [WALL, TABLE])
    assert (mixed == beside_another(region)).all()


def test_a_crease_is_an_edge_and_the_border_of_the_photo_is_none() -> None:
    roof = [quad([-3, -3, -3], [3, 0, 3], [0, 6, 0]), quad([0, -3, 0], [3, 0, -3], [0, 6, 0])]
    mixed, _ = mixed_picture(roof, [WALL, WALL])
    assert mixed[:, 29:31].all() and not mixed[:, :29].any() and not mixed[:, 31:].any()


def test_a_plane_seen_at_a_grazing_angle_has_no_edge_but_its_end() -> None:
    slope = quad([-3, -3, -30], [6, 0, 0], [0, 3, 29.0])
    mixed, region = mixed_picture([slope], [WALL])
    seen = region == WALL
    assert seen.any() and not seen.all()
    assert (mixed[seen] == beside_another(region)[seen]).all()


def test_a_single_pixel_in_the_corner_of_a_photo_is_mixed() -> None:
    speck = quad([-1.5, 1.47, 0], [0.03, 0, 0], [0, 0.03, 0])
    mixed, region = mixed_picture([speck], [WALL])
    assert (region == WALL).sum() == 1 and mixed[region == WALL].all()


@pytest.mark.parametrize(("side", "inner"), [(0.25, 0), (0.5, 16)])
def test_inner_pixels_are_three_off_the_edge(side: float, inner: int) -> None:
    """A square of 5 or of 10 pixels a side before a wall; the outermost are mixed, and two more are left out."""
    square = quad([-side / 2, -side / 2, 0], [side, 0, 0], [0, side, 0])
    regions, camera, samples = photographed([quad([-3, -3, -0.5], [6, 0, 0], [0, 6, 0]), square], [WALL, TABLE])
    mixed = mixed_pixels(samples, regions, [camera])
    found = off_edges(samples, mixed, [camera])
    assert (found & (regions[samples.face] == TABLE)).sum() == inner
    picture = np.zeros((2, 60, 60), bool)
    picture[0].flat[samples.pixel], picture[1].flat[samples.pixel] = mixed, found
    np.testing.assert_array_equal(picture[1], ~binary_dilation(picture[0], np.ones((5, 5))))


def test_a_bar_before_a_window_has_a_brighter_neighbour_and_nothing_has_a_darker_or_coplanar_one() -> None:
    """The bar before the bright half of a wall; the other half is darker than it."""
    regions, camera, samples = photographed([WIDE_WALL, quad([-0.06, -3, 0.5], [0.12, 0, 0], [0, 6, 0])], [WALL, TABLE])
    bar, upper = regions[samples.face] == TABLE, samples.position[:, 1] > 0
    z = np.where(bar, 0.7, np.where(upper, 1.0, 0.2))[:, None].repeat(3, 1)
    mixed = mixed_pixels(samples, regions, [camera])
    by = brighter_neighbours(samples, z, mixed, regions, [camera])
    assert bar.sum() > 100 and mixed[bar].all()
    apart = np.abs(samples.position[:, 1]) > 0.1
    assert (by[bar & upper & apart] >= 0).all() and (by[bar & ~upper & apart] < 0).all()
    assert not bar[by[bar & (by >= 0)]].any()
    # Of the wall, the bar outshines what is darker beside it.
    assert bar[by[~bar & (by >= 0)]].all() and not (by[~bar & upper & apart] >= 0).any()


def test_observations_are_means_over_unmixed_pixels() -> None:
    """Two patches of four pixels each, half of the first and all of the second on an edge."""
    patch, view = np.repeat([0, 1], 4).astype(np.int32), np.zeros(8, np.int16)
    z = np.repeat(np.array([0.2, 0.2, 1.0, 1.0, 0.4, 0.6, 0.4, 0.6], np.float32)[:, None], 3, 1)
    mixed = np.arange(8) >= 2
    pixel = np.array([0, 2, 30, 32, 5, 6, 7, 8], np.int32)  # four corners of a square in a photo 15 wide, and a row
    o = observe(patch, view, pixel, np.array([15]), z, mixed, False, np.random.default_rng(0))
    assert o.count.tolist() == [4, 4] and o.sample[0] < 2 and o.pixel[0] == 16 and o.pixel[1] in (6, 7)
    assert o.z[0] == pytest.approx(0.2, abs=1e-3) and o.z[1] == pytest.approx(0.5)
    assert o.saturated[0] == pytest.approx(0, abs=2e-3)
    assert o.spread[1] == pytest.approx(0.1, abs=1e-3)


def fused(value: np.ndarray, weight: np.ndarray) -> TexelAlbedo:
    """A square of texels, all of them seen."""
    n = len(weight)
    return TexelAlbedo(np.arange(n), value.astype(np.float32), weight.astype(np.float32))


def test_an_edge_takes_the_colour_of_a_plain_region_and_its_neighbours_of_a_textured_one() -> None:
    """The first column lies on an edge; stripes run across it."""
    size = 16
    stripes = np.where(np.arange(size) // 4 % 2, 0.6, 0.2)[:, None] * np.ones((1, size))
    weight = np.ones((size, size))
    weight[:, 0] = 1e-3
    region = np.zeros(size * size, np.int32)
    for albedo in (np.full((size, size), 0.4), stripes):
        contaminated = albedo.copy()
        contaminated[:, 0] = 0.95
        value = np.repeat(contaminated.reshape(-1, 1), 3, 1)
        mean = np.full((1, 3), 0.4, np.float32)
        found = with_expected(fused(value, weight.ravel()), region, mean, size)[:, 0].reshape(size, size)
        inside = np.arange(size) % 4 % 3 > 0  # rows whose neighbours are of one stripe
        assert found[inside, 0] == pytest.approx(albedo[inside, 0], abs=0.06)
        assert found[:, 1:] == pytest.approx(albedo[:, 1:], abs=0.02)


def test_an_edge_takes_nothing_from_the_chart_of_another_region_beside_it() -> None:
    """Two striped regions side by side, the last column of the first one on an edge."""
    size = 16
    region = np.repeat((np.arange(size) >= 8)[None], size, 0).astype(np.int32)
    value = np.where(region == 0, 0.6, 0.1) * np.where(np.arange(size) % 2, 0.7, 1.3)
    value[:, 7] = 0.95
    weight = np.where(np.arange(size) == 7, 1e-4, 1.0) * np.ones((size, 1))
    mean = np.array([[0.6] * 3, [0.1] * 3], np.float32)
    texels = fused(np.repeat(value.reshape(-1, 1), 3, 1), weight.ravel())
    found = with_expected(texels, region.ravel(), mean, size)[:, 0].reshape(size, size)
    assert found[:, 7] == pytest.approx(np.full(size, 0.78), abs=0.05)


def test_an_edge_without_good_neighbours_takes_the_colour_of_its_region() -> None:
    value = np.tile([0.9, 0.9, 0.9], (16, 1))
    mean = np.array([[0.3, 0.2, 0.1]], np.float32)
    found = with_expected(fused(value, np.full(16, 1e-4)), np.zeros(16, np.int32), mean, 4)
    assert found == pytest.approx(np.tile(mean, (16, 1)), abs=0.01)


def test_a_texel_that_only_mixed_pixels_show_stays_uncertain_however_many() -> None:
    """Head-on, at the usual distance: on an edge of a model, of a scan, and on none."""
    one, n = np.ones(3), 500
    mixed, scanned = np.array([True, True, False]), np.array([False, True, False])
    pixels = cast(PixelSamples, SimpleNamespace(cosine=one, footprint=0.01 * one))
    weight = pixel_weight(pixels, np.ones((3, 3)), np.zeros((3, 3)), mixed, scanned, UsualPixel(0.01, 1.0)).max(1)
    assert 0 < n * weight[0] < EXPECTED_WEIGHT < n * weight[1] and weight[2] > 10 * EXPECTED_WEIGHT
