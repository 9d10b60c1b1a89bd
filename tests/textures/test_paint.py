"""Paint of one colour and detail: which departures from a colour are taken for errors of the light."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.surface.irradiance import IrradianceField
from iris_addon.textures.paint import LIGHT_ERROR, find_paint, light_error

WALL = np.array([0.7, 0.65, 0.6])
N = 6000


def even_light(n: int = N) -> np.ndarray:
    return np.full(n, LIGHT_ERROR)


def one_region(albedo: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, float]:
    """The albedo evened, and the share of the region that is detail."""
    region = np.zeros(len(albedo), np.int64)
    paint = find_paint(albedo, error, region, np.ones(1, bool))
    return paint.evened(albedo, error, region), float(paint.detail[0])


def test_a_wall_has_one_colour_although_its_light_is_wrong_in_corners() -> None:
    rng = np.random.default_rng(0)
    error = np.where(np.arange(N) < N // 5, 0.2, LIGHT_ERROR)
    off = error * np.abs(rng.standard_normal(N)) * np.where(error > 0.1, 1, rng.choice([-1, 1], N))
    evened, detail = one_region(WALL * np.exp(off)[:, None], error)
    assert detail < 0.02
    assert np.percentile(np.abs(evened / WALL - 1), 99) < 0.01, "corners, all too bright, do not move its colour"


@pytest.mark.parametrize("share", [0.03, 0.1, 0.3])
def test_joints_between_tiles_stay(share: float) -> None:
    rng = np.random.default_rng(1)
    joint = rng.random(N) < share
    albedo = WALL * np.where(joint, 0.6, 1.0)[:, None] * np.exp(0.01 * rng.standard_normal(N))[:, None]
    evened, detail = one_region(albedo, even_light())
    assert detail == pytest.approx(share, abs=0.02)
    assert np.ptp(evened[~joint], axis=0).max() < 0.01, "the tiles are of one colour"
    assert evened[joint] == pytest.approx(albedo[joint], rel=0.02)


@pytest.mark.parametrize("contrast", [0.05, 0.2, 0.7])
def test_wood_and_weaves_stay(contrast: float) -> None:
    rng = np.random.default_rng(2)
    albedo = np.clip(0.4 * np.exp(contrast * rng.standard_normal((N, 1))) * [1.2, 1, 0.8], 0, 0.95)
    evened, _ = one_region(albedo, even_light())
    kept = np.log(evened).std() / np.log(albedo).std()
    assert kept > (0.9 if contrast == 0.05 else 0.99)


def test_the_same_spot_is_an_error_in_a_corner_and_a_stain_on_even_ground() -> None:
    albedo = np.tile(WALL, (N, 1))
    albedo[:30] *= 0.85
    corner = even_light()
    corner[:30] = 0.15
    in_corner, _ = one_region(albedo, corner)
    on_ground, _ = one_region(albedo, even_light())
    assert in_corner[:30] == pytest.approx(albedo[30:60], rel=0.02)
    assert on_ground[:30] == pytest.approx(albedo[:30], rel=0.01)


def test_light_is_wrong_in_brightness_rather_than_in_colour() -> None:
    """Both spots are as far off; one is a print in another colour."""
    error = np.full(N, 0.1)
    grey, tinted = np.tile(WALL, (N, 1)), np.tile(WALL, (N, 1))
    grey[:30] *= np.exp(-0.15)
    tinted[:30] *= np.exp([-0.26, 0.0, 0.26])
    assert one_region(grey, error)[0][:30] == pytest.approx(grey[30:60], rel=0.03)
    assert one_region(tinted, error)[0][:30] == pytest.approx(tinted[:30], rel=0.03)


def test_metals_and_regions_of_few_texels_stay_as_they_are() -> None:
    rng = np.random.default_rng(3)
    region = np.repeat([0, 1, 2], [N, 15, N])
    albedo = WALL * np.exp(0.01 * rng.standard_normal((len(region), 1)))
    error, even = even_light(len(region)), np.array([False, True, True])
    paint = find_paint(albedo, error, region, even)
    evened = paint.evened(albedo, error, region)
    assert np.array_equal(evened[region < 2], albedo[region < 2].astype(np.float32))
    assert np.ptp(evened[region == 2], axis=0).max() < 1e-3
    mean = np.array([[0.1, 0.2, 0.3]] * 3)
    assert paint.colour(mean)[:2] == pytest.approx(mean[:2])
    assert paint.colour(mean)[2] == pytest.approx(WALL, rel=0.01)


def test_the_error_of_light_is_relative_in_light_and_absolute_in_the_dark() -> None:
    error = light_error(np.zeros(3), np.array([10.0, 0.1, 0.01]))
    assert error[0] == pytest.approx(LIGHT_ERROR, rel=0.02)
    assert error[1] == pytest.approx(np.hypot(LIGHT_ERROR, 0.2)) and error[2] == pytest.approx(1, rel=0.01)


def test_the_error_of_light_grows_with_its_spread_over_patches() -> None:
    """A floor lit twice as much beyond a line: beside the line the spread is that of half of each."""
    x, y = np.meshgrid(np.arange(30), np.arange(30))
    position = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1).astype(np.float32)
    normal = np.tile(np.float32([0, 0, 1]), (len(position), 1))
    field = IrradianceField.of(position, normal, np.ones(len(position), np.float32))
    irradiance = np.where(position[:, :1] < 14.5, 1.0, 2.0) * np.ones(3)
    spread = field.spread(irradiance)
    far = np.abs(position[:, 0] - 14.5) > 4
    assert spread[far].max() < 1e-3
    beside = (np.abs(position[:, 0] - 14.5) < 1) & (np.abs(position[:, 1] - 15) < 10)
    share = 0.27  # of the Gaussian kernel over the nine nearest patches, beyond the line
    assert spread[beside] == pytest.approx(np.log(2) * np.sqrt(share * (1 - share)), rel=0.15)
    lit = np.full(len(spread), 1e6)
    assert light_error(np.zeros(1), lit[:1])[0] == pytest.approx(LIGHT_ERROR)
    assert light_error(np.zeros(1), lit[:1])[0] < light_error(spread[beside], lit[beside]).min()
