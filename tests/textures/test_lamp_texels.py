"""The texture of a lamp's pattern: its mean, and what clips in all photos."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model.capture import Mesh
from iris_addon.rays.tracer import Tracer
from iris_addon.textures.atlas import Atlas
from iris_addon.textures.bake import TexelAlbedo
from iris_addon.textures.lamp_texels import PatternedLamp, lamp_pattern, with_clipped
from iris_addon.textures.principled import PaintedTexels
from iris_addon.textures.texel_points import TexelPoints
from tests.result_room import box

SIZE, LEVEL = 64, 4.0
MESH = box()
assert MESH.uv is not None
ATLAS = Atlas.of(MESH.uv, SIZE, np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
TRACER = Tracer(MESH)
POINTS = TexelPoints.of(TRACER, MESH.uv, SIZE)
LAMP = np.isin(POINTS.face, [4, 5])
BRIGHT = POINTS.position[:, 0] > 0.5


def made(texels: PaintedTexels, lamps: list[PatternedLamp]) -> tuple[np.ndarray, list[np.ndarray]]:
    return lamp_pattern(ATLAS, texels, TRACER.areas, lamps)


def lamp(radiance: float = 1.0, brightest: float = 1.0) -> PatternedLamp:
    return PatternedLamp(np.array([4, 5]), np.full(3, radiance), LEVEL, brightest)


def painted(radiance: np.ndarray, weight: np.ndarray | float = 1.0, bounded: np.ndarray | None = None) -> PaintedTexels:
    """Texels (T,) of a grey ``radiance``; NaN ones are not shown."""
    seen = np.flatnonzero(np.isfinite(radiance))
    value = np.repeat(radiance[seen, None] / LEVEL, 3, axis=1).astype(np.float32)
    weights = np.broadcast_to(np.asarray(weight, np.float32), radiance.shape)[seen]
    fused = TexelAlbedo(POINTS.texel[seen], value, weights)
    n = len(radiance)
    clips = np.zeros(n, bool) if bounded is None else bounded
    measured = np.repeat(np.isfinite(radiance)[:, None], 3, axis=1)
    return PaintedTexels(
        points=POINTS,
        fused=fused,
        light_error=np.zeros(n),
        bounded=np.repeat(clips[:, None], 3, axis=1),
        measured=measured,
    )


def on_lamp(pattern: np.ndarray, where: np.ndarray) -> np.ndarray:
    return pattern.reshape(-1, 3)[POINTS.texel[LAMP & where]]


def test_the_pattern_is_what_photos_show_over_its_mean_and_one_elsewhere():
    pattern, (mean,) = made(painted(np.where(BRIGHT, 3.0, 0.5)), [lamp()])
    share = np.mean([BRIGHT[POINTS.face == face].mean() for face in (4, 5)])  # two halves of one side
    np.testing.assert_allclose(mean, 3 * share + 0.5 * (1 - share), rtol=1e-5)
    np.testing.assert_allclose(on_lamp(pattern, BRIGHT) * mean, 3.0, rtol=1e-5)
    np.testing.assert_allclose(on_lamp(pattern, ~BRIGHT) * mean, 0.5, rtol=1e-5)
    assert (pattern[(ATLAS.face >= 0) & ~np.isin(ATLAS.face, [4, 5])] == 1).all()


def test_what_clips_everywhere_gets_what_the_light_of_the_room_leaves_for_it():
    dark = np.where(BRIGHT, np.nan, 0.5)
    pattern, (mean,) = made(painted(dark, bounded=BRIGHT), [lamp(radiance=2.0)])
    np.testing.assert_allclose(mean, 2.0, rtol=1e-5)
    np.testing.assert_allclose(on_lamp(pattern, ~BRIGHT) * mean, 0.5, rtol=1e-5)
    bright = on_lamp(pattern, BRIGHT) * mean
    assert np.ptp(bright) < 1e-5 and bright.min() > 2.0


def test_what_clips_is_no_darker_than_the_photos_can_show():
    radiance, area = np.array([[0.2] * 3, [np.nan] * 3]), np.ones(2)
    clips = np.array([[False] * 3, [True] * 3])
    small = np.array([99.0, 1.0])
    np.testing.assert_allclose(with_clipped(radiance, clips, small, lamp(3.0, 1.0))[1], 1.0, err_msg="a speck")
    assert with_clipped(radiance, clips, area, lamp(0.3, 1.0)).tolist() == [[0.2] * 3, [1.0] * 3]
    np.testing.assert_allclose(with_clipped(radiance, clips, area, lamp(3.0, 1.0))[1], 5.8)
    assert np.isnan(radiance[1]).all(), "the argument stays as it is"


@pytest.mark.parametrize("bounded", [True, False])
def test_doubtful_texels_at_the_rim_continue_those_beside_them(bounded: bool):
    """Pixels across the border of a lamp show its surroundings too; they are neither its pattern nor clipped."""
    rim = np.abs(POINTS.position[:, 2] - 0.5) > 0.4
    values, weight = np.where(rim, 0.01, 1.0), np.where(rim, 1e-4, 1.0)
    pattern, (mean,) = made(painted(values, weight, rim & bounded), [lamp(radiance=5.0)])
    np.testing.assert_allclose(mean, 1.0, rtol=1e-5)
    np.testing.assert_allclose(on_lamp(pattern, rim | True), 1.0, atol=1e-3)


def test_a_lamp_that_no_sure_texel_shows_stays_even_beside_one_that_is_shown():
    """Thin ones have mixed pixels alone. Nothing to fill from is no reason to be black."""
    other = PatternedLamp(np.array([8, 9]), np.full(3, 2.0), LEVEL, 1.0)
    unsure = np.isin(POINTS.face, [8, 9])
    texels = painted(np.where(BRIGHT, 3.0, 0.5), np.where(unsure, 1e-4, 1.0))
    for lamps in ([other], [lamp(), other]):
        pattern, means = made(texels, lamps)
        np.testing.assert_allclose(means[-1], 2.0)
        np.testing.assert_allclose(pattern.reshape(-1, 3)[POINTS.texel[unsure]], 1.0)


def test_a_channel_that_is_black_in_all_photos_is_dark_and_the_others_count():
    texels = painted(np.where(BRIGHT, 3.0, 0.5))
    texels.fused.value[:, 2] = np.nan
    pattern, (mean,) = made(texels, [lamp()])
    np.testing.assert_allclose(on_lamp(pattern, BRIGHT)[:, :2] * mean[:2], 3.0, rtol=1e-5)
    assert mean[2] == 0 and (on_lamp(pattern, BRIGHT)[:, 2] == 0).all()


def test_a_face_without_area_on_the_atlas_does_not_decide_the_mean():
    """A sliver whose texture coordinates coincide has one texel, of its own small area."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0.5, 1e-3, 0], [0.51, 2e-3, 0], [0.5, 2e-3, 0]], float)
    uv = np.array([[[0.1, 0.1], [0.8, 0.1], [0.8, 0.8]], [[0.05, 0.9]] * 3], np.float32)
    tracer = Tracer(Mesh(corners, np.array([[0, 1, 2], [3, 4, 5]]), uv))
    points, atlas = TexelPoints.of(tracer, uv, SIZE), Atlas.of(uv, SIZE, np.zeros(0, np.int32), np.zeros((0, 2)))
    value = np.where(points.face[:, None] == 0, 0.5, 0.01) * np.ones(3)
    fused = TexelAlbedo(points.texel, value.astype(np.float32), np.ones(len(points.face), np.float32))
    none = np.zeros((len(points.face), 3), bool)
    error = np.zeros(len(points.face))
    texels = PaintedTexels(points=points, fused=fused, light_error=error, bounded=none, measured=~none)
    _, (mean,) = lamp_pattern(atlas, texels, tracer.areas, [PatternedLamp(np.arange(2), np.ones(3), 1.0, 1.0)])
    np.testing.assert_allclose(mean, 0.5, rtol=1e-3)


def test_a_channel_that_no_photo_measures_continues_the_texels_beside_it_and_is_not_black():
    """Beside what clips, a coarse texel has no sample of the channel that clips."""
    texels = painted(np.full(len(POINTS.texel), 1.0))
    beside = np.abs(POINTS.position[:, 0] - 0.5) < 0.1
    texels.fused.value[beside, 0] = np.nan
    texels.measured[beside, 0] = False
    pattern, (mean,) = made(texels, [lamp()])
    np.testing.assert_allclose(mean, 1.0, rtol=1e-5)
    np.testing.assert_allclose(on_lamp(pattern, beside), 1.0, atol=1e-3)


def test_red_that_clips_says_nothing_of_blue_that_is_black():
    texels = painted(np.full(len(POINTS.texel), 0.5))
    texels.fused.value[BRIGHT] = [np.nan, 0.1, np.nan]
    texels.bounded[BRIGHT, 0] = True
    pattern, (mean,) = made(texels, [lamp(radiance=1.0)])
    bright = on_lamp(pattern, BRIGHT) * mean
    assert (bright[:, 0] >= 1).all() and (bright[:, 2] == 0).all()


def test_what_no_photo_shows_of_a_lamp_does_not_make_little_of_what_clips():
    """A shade that is seen from one side: nearly half of what is seen clips."""
    radiance, clips, area = np.full((100, 3), np.nan), np.zeros((100, 3), bool), np.ones(100)
    radiance[:6], clips[6:10] = 1.0, True
    complete = with_clipped(radiance, clips, area, lamp(20.0, 1.2))
    np.testing.assert_allclose(np.nanmean(complete, axis=0), 20.0)
