"""Texels read from photos at the photos' own resolution, and fused so that they explain each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from iris_addon.model.capture import Camera, Distortion, View
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples
from iris_addon.textures.bake import UsualPixel, pixel_weight
from iris_addon.textures.charts import build_atlas
from iris_addon.textures.fusion import TEXEL_SAMPLE, fuse_samples, pixel_kernel
from iris_addon.textures.photo_texels import SeenTexels, halved, interpolated, on_edges, read_texels, seen_texels
from iris_addon.textures.principled import EXPECTED_WEIGHT
from iris_addon.textures.texel_points import TexelPoints
from tests.box_room import box_mesh, look_at
from tests.engine_room import assemble, quad

SIDE = 48


def plane(side: int, pitch: float = 0.01) -> TexelPoints:
    """Texels of a square atlas that lie side by side on the floor."""
    row, column = np.divmod(np.arange(side * side), side)
    position = np.stack([column * pitch, -row * pitch, 0 * row], 1).astype(np.float32)
    n = len(row)
    up = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    return TexelPoints(
        texel=np.arange(n),
        face=np.zeros(n, np.int32),
        position=position,
        normal=up,
        size=np.full(n, pitch, np.float32),
    )


def photo_of(row: np.ndarray, value: np.ndarray, weight: np.ndarray | float = 1.0, blur: float = 0.5) -> np.ndarray:
    """What a photo shows of the texels ``row``."""
    table = np.zeros(len(row), TEXEL_SAMPLE)
    table["row"], table["value"], table["weight"], table["blur"] = row, value, weight, blur
    return table


# ---- fusion --------------------------------------------------------------------------------------------------------


def test_fusing_is_robust_and_marks_channels_that_were_always_clipped() -> None:
    points, row = plane(2, pitch=1.0), np.arange(3)
    points = replace(points, size=np.full(4, 0.01, np.float32))  # too far apart to be neighbours
    photos = []
    for k in range(12):
        value, weight = np.tile([0.4, 0.3, 0.2], (3, 1)), np.ones((3, 3))
        value[0] = 0.95 if k in (3, 7) else value[0]  # a highlight in two of twelve photos
        weight[1, 0] = 0  # red clipped in every photo
        weight[2] = 0  # every channel is
        photos.append(photo_of(row, value, weight))
    fused = fuse_samples(photos, points, 2)
    assert fused.texel.tolist() == [0, 1] and fused.weight == pytest.approx([12, 12])
    assert fused.value[0] == pytest.approx([0.4, 0.3, 0.2], abs=0.04)
    assert np.isnan(fused.value[1, 0]) and fused.value[1, 1:] == pytest.approx([0.3, 0.2], abs=1e-3)


def test_a_channel_that_is_black_in_every_photo_is_unknown() -> None:
    """Of two texels blue has a three hundredth of the weight that red has, and a fiftieth."""
    points = replace(plane(2, pitch=1.0), size=np.full(4, 0.01, np.float32))
    weight = np.array([[1, 1, 0.003], [1, 1, 0.02]])
    fused = fuse_samples([photo_of(np.arange(2), np.tile([0.5, 0.4, 0.05], (2, 1)), weight)] * 10, points, 2)
    assert np.isnan(fused.value).tolist() == [[False, False, True], [False] * 3]


def test_what_clips_in_most_photos_is_not_taken_from_the_few_that_show_it_darker() -> None:
    """Three texels: the edge of a dark thing leaks onto one that clips; a dark one whose bounds agree; a highlight."""
    points, row = replace(plane(2, pitch=1.0), size=np.full(4, 0.01, np.float32)), np.arange(3)
    dark = photo_of(row, np.array([[0.1] * 3, [0.1] * 3, [0.3] * 3]), np.array([[0.05] * 3, [0.05] * 3, [1.0] * 3]))
    clipped = photo_of(row, np.array([[0.6] * 3, [0.08] * 3, [0.8] * 3]), 1.0)
    clipped["at_least"] = True
    clipped["weight"][2, 2] = 0  # tells nothing of blue
    fused = fuse_samples([dark] * 3 + [clipped] * 2, points, 2)
    assert fused.texel.tolist() == [1, 2]
    assert fused.value[0] == pytest.approx([0.1] * 3, abs=1e-3) and fused.weight[0] == pytest.approx(0.15, rel=1e-2)
    assert fused.value[1] == pytest.approx([0.3] * 3, abs=1e-3)


def pattern(side: int) -> np.ndarray:
    """(side², 3) a soft checkerboard of a period of five texels."""
    wave = np.sin(2 * np.pi * np.arange(side) / 5)
    return np.repeat((0.4 + 0.2 * np.outer(wave, wave)).reshape(-1, 1), 3, 1)


def as_shown(texture: np.ndarray, blur: float) -> np.ndarray:
    """The texture as pixels of ``blur`` texels show it."""
    half = pixel_kernel(blur)
    taps, picture = np.concatenate([half[:0:-1], half]), texture.reshape(SIDE, SIDE, 3)
    return convolve1d(convolve1d(picture, taps, axis=0), taps, axis=1).reshape(-1, 3)


def contrast(texture: np.ndarray) -> float:
    """Standard deviation within the picture, away from its border."""
    return float(texture.reshape(SIDE, SIDE, 3)[8:-8, 8:-8].std())


@pytest.mark.parametrize("on_scan", [False, True])
def test_mixed_pixels_colour_a_texel_only_where_no_others_show_it_and_on_scans_alone(on_scan: bool) -> None:
    n, usual = 9, UsualPixel(footprint=0.01, irradiance=1.0)
    up = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    head_on = PixelSamples(
        view=np.arange(n, dtype=np.int16),
        pixel=np.zeros(n, np.int32),
        face=np.zeros(n, np.int32),
        barycentric=np.zeros((n, 2), np.float32),
        position=np.zeros((n, 3), np.float32),
        normal=up,
        direction=up,
        footprint=np.full(n, 0.01, np.float32),
    )
    mixed, scanned = np.arange(n) > 0, np.full(n, on_scan)
    weight = pixel_weight(head_on, np.ones((n, 3)), np.zeros((n, 3)), mixed, scanned, usual)[:, 0]
    assert (weight[1:] > EXPECTED_WEIGHT).all() == on_scan  # certain by one of them, and what no photo shows is not
    assert weight[1:].sum() < 0.5 * weight[0]


def test_far_photos_do_not_blur_what_a_near_one_shows() -> None:
    """One near photo and nine from twice and four times as far, with weights by resolution."""
    truth, row = pattern(SIDE), np.arange(SIDE * SIDE)
    kinds = [(1.2, 1.0, 1), (2.4, 0.25, 5), (4.8, 0.06, 4)]
    photos = [photo_of(row, as_shown(truth, blur), weight, blur) for blur, weight, count in kinds for _ in range(count)]
    mean = sum(w * n * as_shown(truth, blur) for blur, w, n in kinds) / sum(w * n for _, w, n in kinds)
    fused = fuse_samples(photos, plane(SIDE), SIDE)
    assert contrast(mean) < 0.6 * contrast(truth)
    assert 0.9 * contrast(truth) < contrast(fused.value) < 1.1 * contrast(truth)
    inside = (slice(8, -8), slice(8, -8))
    shown = as_shown(fused.value.astype(float), 1.2).reshape(SIDE, SIDE, 3)[inside]
    assert shown == pytest.approx(as_shown(truth, 1.2).reshape(SIDE, SIDE, 3)[inside], abs=0.02)


def test_even_texels_stay_even_beside_another_chart() -> None:
    """Two halves of the atlas that do not lie beside each other in the room."""
    points, row = plane(SIDE), np.arange(SIDE * SIDE)
    far = row % SIDE >= SIDE // 2
    points = replace(points, position=points.position + far[:, None].astype(np.float32))
    value = np.where(far[:, None], 0.8, [[0.2, 0.3, 0.1]])
    fused = fuse_samples([photo_of(row, value, 1.0, 2.4)], points, SIDE)
    assert fused.value == pytest.approx(value, abs=2e-3)


# ---- reading -------------------------------------------------------------------------------------------------------


def ramp(height: int, width: int) -> np.ndarray:
    """(h, w, 3) float32 linear in both directions, measured at pixel centres."""
    j, i = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([j, i, j + 2 * i], -1).astype(np.float32)


def test_reading_between_pixels_keeps_a_ramp_and_most_of_a_fine_pattern() -> None:
    place = np.random.default_rng(0).uniform(2, 18, (200, 2)).astype(np.float32)
    x, y = place.T
    assert interpolated(ramp(20, 20), place) == pytest.approx(np.stack([x, y, x + 2 * y], -1), abs=1e-4)
    wave = np.repeat(np.sin(2 * np.pi * (np.arange(40) + 0.5) / 5)[None, :, None], 12, 0).repeat(3, 2) + 2
    place = np.stack([np.linspace(4, 36, 1000), np.full(1000, 6.3)], 1).astype(np.float32)
    shown = interpolated(wave.astype(np.float32), place)[:, 0] - 2
    assert shown.std() > 0.93 * np.sqrt(0.5), "linear interpolation would keep 0.88"


def test_a_clipped_pixel_is_left_out_and_beside_it_nothing_is_known() -> None:
    photo = ramp(12, 12)
    photo[6, 6, 1] = np.nan
    place = np.array([[5.9, 6.5], [6.4, 6.4], [7.7, 6.5], [8.2, 8.1]], np.float32)
    value = interpolated(photo, place)
    assert np.isnan(value[:, 1]).tolist() == [True, True, False, False]
    assert value[2:, 1] == pytest.approx(place[2:, 1], abs=1e-4) and value[:, 0] == pytest.approx(place[:, 0], abs=1e-4)
    assert np.isnan(halved(photo)[..., 1]).sum() == 1


def test_texels_wider_than_pixels_take_the_mean_over_them() -> None:
    photo = np.random.default_rng(1).random((64, 64, 3)).astype(np.float32)
    place = np.array([[16.0, 24.0], [40.0, 40.0]], np.float32)
    seen = SeenTexels(
        row=np.arange(2),
        place=place,
        file_place=place,
        toward=np.zeros((2, 3), np.float32),
        cosine=np.ones(2, np.float32),
        footprint=np.ones(2, np.float32),
    )
    nowhere = np.zeros(2, bool)
    value, averaged = read_texels(photo, seen, np.array([8.0, 1.0]), nowhere)
    assert averaged.tolist() == [8, 1]
    assert value[0] == pytest.approx(np.full(3, 0.5), abs=0.1)
    assert value[1] == pytest.approx(interpolated(photo, place[1:])[0])
    value, averaged = read_texels(photo, seen, np.array([8.0, 1.0]), ~nowhere)
    assert averaged.tolist() == [1, 1] and value == pytest.approx(photo[[24, 40], [16, 40]])


CAMERA = Camera(width=64, height=48, fx=50, fy=50, cx=32, cy=24, c2w=look_at(np.array([0.7, 0.6, 1.2]), np.ones(3) * 3))


def test_texels_are_seen_where_the_camera_projects_them() -> None:
    mesh = box_mesh()
    tracer = Tracer(mesh)
    points = TexelPoints.of(tracer, build_atlas(mesh, np.full(12, 50.0), 128), 128)
    seen = seen_texels(tracer, points, View("a", CAMERA, None))
    local = CAMERA.local(points.position[seen.row])
    assert len(seen.row) > 500 and seen.place == pytest.approx(CAMERA.project(local), abs=1e-3)
    assert seen.footprint == pytest.approx(np.linalg.norm(local, axis=1) / 50, rel=1e-4)
    lens = Distortion(k1=-0.2, k2=0.05)
    bent = seen_texels(tracer, points, View("a", CAMERA, None, distortion=lens))
    x = (bent.place - [32, 24]) / 50
    r2 = (x**2).sum(1, keepdims=True)
    assert bent.file_place == pytest.approx(x * (1 - 0.2 * r2 + 0.05 * r2**2) * 50 + [32, 24], abs=1e-3)
    assert len(points.texel) == len(np.unique(points.texel)) and set(points.face) == set(range(12))
    uncovered = TexelPoints.of(tracer, build_atlas(mesh, np.full(12, 50.0), 16) * 0.05, 8)
    assert len(uncovered.texel) > 0, "faces without a texel's centre have the texel of their middle"


def test_what_stands_before_a_wall_hides_it_and_does_not_colour_it() -> None:
    mesh = assemble([quad([-3, -3, 0], [6, 0, 0], [0, 6, 0]), quad([-0.5, -0.4, 0.5], [1, 0, 0], [0, 0.8, 0])], [0, 1])
    assert mesh.regions is not None
    tracer, size = Tracer(mesh), 60
    pose = look_at(np.array([0, -1e-3, 3.0]), np.zeros(3))
    camera = Camera(width=size, height=size, fx=size, fy=size, cx=size / 2, cy=size / 2, c2w=pose)
    points = TexelPoints.of(tracer, build_atlas(mesh, np.full(4, 100.0), 256), 256)
    seen = seen_texels(tracer, points, View("a", camera, None))
    on_wall = mesh.regions[points.face[seen.row]] == 0
    offset = np.abs(seen.place - 30) - np.array([12, 9.6])  # the table appears 24 by 19.2 pixels large
    outside = offset.max(1)
    assert (outside[on_wall] > -0.1).all() and (outside[~on_wall] < 0.1).all() and (~on_wall).sum() > 50
    edge = on_edges(tracer, points, seen, np.ones(len(seen.row), bool), mesh.regions, camera)
    assert edge[np.abs(outside) < 0.45].all()
    away = (np.abs(outside) > 2.1) & (np.abs(seen.place - 30).max(1) < 27)
    assert not edge[away].any()
    # Pixels are means over their area, so that those on the outline have a colour between those of table and wall.
    inside = [np.clip(reach + 0.5 - np.abs(np.arange(size) + 0.5 - 30), 0, 1) for reach in (9.6, 12)]
    photo = np.repeat(0.8 - 0.6 * np.outer(*inside)[..., None], 3, 2).astype(np.float32)
    value, _ = read_texels(photo, seen, np.full(len(seen.row), 0.3), np.ones(len(seen.row), bool))
    beside = ~edge & (np.abs(outside) < 2)
    assert beside.sum() > 100 and value[~edge, 0] == pytest.approx(np.where(on_wall, 0.8, 0.2)[~edge], abs=1e-6)
