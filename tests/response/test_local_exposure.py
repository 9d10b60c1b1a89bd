"""Local tone mapping and vignetting: found where photos have them, undone exactly, and not found where they do not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from iris_addon.decide import Decisions
from iris_addon.model import response as curve
from iris_addon.model.local_exposure import (
    COLUMNS,
    ROWS,
    UNIFORM,
    LocalExposure,
    LocalSettings,
    SmallPhotos,
    gaussian,
    shrink,
    small_photo,
)
from iris_addon.model.response import LUMINANCE
from iris_addon.response import family
from iris_addon.response.observations import Observations
from iris_addon.response.overlap import OverlapFit, find_local_exposure, fit_overlap
from iris_addon.response.overlap_problem import OverlapProblem
from tests.engine_room import observe_off_edges

HEIGHT, WIDTH, N_VIEWS = 72, 96, 16
SIZES = np.tile([HEIGHT, WIDTH], (N_VIEWS, 1))
CAMERA = curve.gamma(0.5)
EXPOSURES = 2.0 ** np.random.default_rng(3).uniform(-4, -0.5, N_VIEWS)


def local_gain(exposed: np.ndarray, settings: LocalSettings) -> np.ndarray:
    """(H, W, 1) gain of a tone mapping and a vignetting at full size, by their definition."""
    height, width = exposed.shape[:2]
    x, y = (np.arange(n) + 0.5 - n / 2 for n in (width, height))
    falloff = settings.falloff * (x**2 + y[:, None] ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    before = np.log(np.minimum(exposed * np.exp(-falloff)[..., None], settings.headroom) @ LUMINANCE)
    base = gaussian_filter(before, settings.scale * width, mode="nearest")
    return np.exp(-settings.strength * (base - np.median(base)) - falloff)[..., None]


@dataclass(frozen=True)
class Wall:
    """A wall of large bright and dark squares of small ones, of which photos from near and far show pieces.

    Were they all taken from one distance, each place would lie among the same neighbours in all of them.
    """

    radiance: np.ndarray
    corner: np.ndarray
    zoom: np.ndarray

    @staticmethod
    def painted(seed: int) -> Wall:
        rng = np.random.default_rng(seed)
        side = 2 * WIDTH
        broad, fine = (np.kron(rng.normal(size=(side // n, side // n)), np.ones((n, n))) for n in (24, 6))
        radiance = np.exp(0.9 * broad + 0.2 * fine)[..., None] * np.array([1.0, 0.9, 0.8])
        corner = rng.integers(0, [side - HEIGHT, side - WIDTH], (N_VIEWS, 2))
        return Wall(radiance, corner, np.arange(N_VIEWS) % 3 + 1)

    def shown(self, view: int, values: np.ndarray) -> np.ndarray:
        (row, column), zoom = self.corner[view], self.zoom[view]
        piece = values[row : row + HEIGHT // zoom, column : column + WIDTH // zoom]
        return np.repeat(np.repeat(piece, zoom, axis=0), zoom, axis=1)

    def photos(self, settings: LocalSettings) -> np.ndarray:
        """(V, H, W, 3) bytes / 255."""
        taken = []
        for view, exposure in enumerate(EXPOSURES):
            exposed = self.shown(view, self.radiance) * exposure
            taken.append(CAMERA.apply(np.clip(exposed * local_gain(exposed, settings), 0, 1)))
        return np.floor(255 * np.array(taken)) / 255

    def observations(self, photos: np.ndarray, rng: np.random.Generator) -> Observations:
        """A patch for each small square."""
        side = len(self.radiance)
        block = np.add.outer(np.arange(side) // 6 * (side // 6), np.arange(side) // 6)
        patch = np.stack([self.shown(view, block) for view in range(N_VIEWS)])
        view, row, column = np.indices(patch.shape).reshape(3, -1)
        return observe_off_edges(patch.ravel(), view, photos.reshape(-1, 3), rng, row * WIDTH + column, WIDTH)


def small(photos: np.ndarray) -> SmallPhotos:
    valid = np.ones((HEIGHT, WIDTH), bool)
    z, clipped = (np.stack(column) for column in zip(*(small_photo(photo, valid) for photo in photos), strict=True))
    return SmallPhotos(z, clipped, SIZES)


@cache
def fitted(settings: LocalSettings, known: bool = True, choice: bool | None = None) -> OverlapFit:
    """The fit to photos with ``settings``, which the model is made to look for, forbidden, or free to find."""
    wall, rng = Wall.painted(1), np.random.default_rng(0)
    photos = wall.photos(settings)
    one_curve = Decisions({"channel_curves": False, "local_exposure": choice})
    exposures = EXPOSURES if known else None
    return fit_overlap(wall.observations(photos, rng), exposures, N_VIEWS, rng, None, one_curve, small(photos))


@pytest.mark.parametrize(
    "settings",
    [LocalSettings(strength=0.5, scale=1 / 12), LocalSettings(strength=0.2, scale=1 / 6), LocalSettings(falloff=0.7)],
)
def test_local_gains_are_recovered_from_photos_made_with_them(settings: LocalSettings) -> None:
    wall = Wall.painted(0)
    photos = wall.photos(settings)
    found = small(photos).local_exposure(settings, CAMERA)
    every = np.arange(HEIGHT * WIDTH)
    for view in (0, 3, 9):
        exposed = wall.shown(view, wall.radiance) * EXPOSURES[view]
        true, undone = local_gain(exposed, settings).ravel(), found.at(np.full(len(every), view), every)
        assert np.sqrt(np.mean(np.log(undone / true) ** 2)) < 0.1 * np.log(true).std()
        assert settings.gain(photos[view], CAMERA).ravel() == pytest.approx(undone, rel=2e-3)


@pytest.mark.parametrize("known", [True, False])
def test_a_tone_mapping_is_found_by_overlap(known: bool) -> None:
    local = fitted(LocalSettings(strength=0.5), known).local
    assert local is not None and local.settings.falloff == 0
    assert local.settings.strength == pytest.approx(0.5, abs=0.05 if known else 0.12)
    assert local.settings.scale == pytest.approx(1 / 12)


def test_a_vignetting_is_found_by_overlap() -> None:
    local = fitted(LocalSettings(falloff=0.7)).local
    assert local is not None and local.settings.strength == 0
    assert local.settings.falloff == pytest.approx(0.7, abs=0.05)


def test_both_are_found_together() -> None:
    local = fitted(LocalSettings(strength=0.4, falloff=0.7)).local
    assert local is not None
    assert local.settings.strength == pytest.approx(0.4, abs=0.08)
    assert local.settings.falloff == pytest.approx(0.7, abs=0.1)


def test_uniformly_exposed_photos_get_no_local_exposure() -> None:
    assert fitted(UNIFORM).local is None


def test_no_local_exposure_is_accepted_without_held_out_patches() -> None:
    wall, rng = Wall.painted(1), np.random.default_rng(0)
    photos = wall.photos(LocalSettings(strength=0.5))
    seen = wall.observations(photos, rng)
    problem = OverlapProblem.build(seen, np.arange(len(seen.patch)), EXPOSURES, N_VIEWS)
    nothing = problem.restrict(np.zeros(problem.n_patches, bool))
    assert find_local_exposure(problem, nothing, small(photos), family.PRIOR_MEAN[None], Decisions()) is None


def test_undoing_a_tone_mapping_recovers_the_curve() -> None:
    settings = LocalSettings(strength=0.5)
    taken, left = (fitted(settings, choice=choice) for choice in (None, False))
    off = [np.linalg.norm(fit.response.samples - CAMERA.samples) for fit in (taken, left)]
    assert taken.residual < 0.6 * left.residual and off[0] < 0.7 * off[1]


def test_local_exposure_can_be_forced_and_forbidden() -> None:
    assert fitted(LocalSettings(strength=0.5), choice=False).local is None
    forced = fitted(UNIFORM, choice=True).local
    assert forced is not None and forced.settings.strength < 0.05 and forced.settings.falloff < 0.05


def test_gaussian_means_keep_constants_and_have_the_given_deviation() -> None:
    mean = gaussian(2.5, 40)
    assert mean.sum(1) == pytest.approx(np.ones(40))
    spread = mean[:, 20] @ (np.arange(40) - 20.0) ** 2
    assert np.sqrt(spread) == pytest.approx(2.5, rel=0.01)
    values = np.random.default_rng(0).random(40)
    assert mean @ values == pytest.approx(gaussian_filter(values, 2.5, mode="nearest"), abs=1e-4)


def test_small_photos_are_means_of_valid_pixels() -> None:
    rng = np.random.default_rng(0)
    values, valid = rng.random((HEIGHT, WIDTH, 3)).astype(np.float32), rng.random((HEIGHT, WIDTH)) < 0.7
    valid[:3, :3] = False
    made = shrink(values, valid)
    cell = values[3:6, 3:6][valid[3:6, 3:6]]
    assert made[1, 1] == pytest.approx(cell.mean(0), abs=1e-6)
    others = made.reshape(-1, 3)[1:]
    assert made[0, 0] == pytest.approx(np.median(others, axis=0), abs=1e-6)
    large = np.random.default_rng(1).random((24 * 40, 32 * 40, 3)).astype(np.float32)
    z, clipped = small_photo(large, np.ones(large.shape[:2], bool))
    assert np.abs(z - 0.5).max() < 0.2 and z.mean() == pytest.approx(0.5, abs=0.005)
    assert clipped.max() < 0.06 and clipped.mean() == pytest.approx(0.5 / 255, abs=0.001)
    tiny = shrink(np.full((5, 7, 3), 0.25, np.float32), np.ones((5, 7), bool))
    assert tiny.shape == (ROWS, COLUMNS, 3) and tiny == pytest.approx(0.25)


def test_local_exposure_survives_a_checkpoint() -> None:
    rng = np.random.default_rng(0)
    log_gain = rng.random((2, ROWS, COLUMNS)).astype(np.float32)
    local = LocalExposure(LocalSettings(0.3, 1 / 6, 2.0, 0.1), log_gain, SIZES[:2])
    read = LocalExposure.from_arrays(local.arrays())
    assert read is not None and read.settings == local.settings
    assert np.array_equal(read.log_gain, local.log_gain) and np.array_equal(read.sizes, local.sizes)
    assert LocalExposure.from_arrays({}) is None
