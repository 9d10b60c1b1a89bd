"""Screens are found by their changing picture; paint, lit paper and highlights are none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.lighting import screens
from iris_addon.lighting.problem import LightProblem, Lights
from iris_addon.lighting.screens import SCREEN_MIN_REFLECTANCE, Shown, find_screens, with_screens
from iris_addon.rays.tracer import Tracer
from iris_addon.response.radiance import GroupRadiance, radiance_itself
from tests.engine_room import assemble, quad

WALL, SCREEN = 0, 1
VIEWS = 8
CELL = 0.05
MESH = assemble(
    [quad([0, 0, 0], [3, 0, 0], [0, 2, 0], CELL), quad([1, 0.8, 0.1], [0.8, 0, 0], [0, 0.5, 0], CELL)], [WALL, SCREEN]
)
assert MESH.regions is not None
REGIONS = MESH.regions
TRACER = Tracer(MESH)
MIDDLE = TRACER.corners.mean(1)
N = len(REGIONS)
ON_SCREEN = REGIONS == SCREEN
WHITE, CYAN, RED = np.array([2.0, 2.0, 2.0]), np.array([0.3, 1.6, 2.2]), np.array([0.5, 0.05, 0.05])


def problem() -> LightProblem:
    """A screen before a wall; every face is a patch and has a pixel in each of VIEWS photos."""
    return SimpleNamespace(  # type: ignore[return-value]
        transport=SimpleNamespace(n_seen=N, n_patches=N),
        surface=SimpleNamespace(position=MIDDLE, normal=TRACER.normals, sample_patch=np.arange(N), count=np.ones(N)),
        samples=SimpleNamespace(face=np.arange(N)),
        tracer=TRACER,
        regions=REGIONS,
        given_emitters=None,
        decisions=Decisions(),
    )


def lit() -> Lights:
    """No lamp, and irradiance / pi of 1 everywhere."""
    none = np.zeros((N, 0, 2), np.float32)
    ones = np.ones((N, 3))
    return Lights(
        emitters=[],
        radiance=np.zeros((0, 3)),
        hidden_radiance=np.zeros((0, 3)),
        log_std=np.zeros(0),
        form_factors=none,
        mask=np.zeros(N, bool),
        irradiance=ones,
        patch_radiance=ones,
    )


def shown(radiance: np.ndarray, specular: np.ndarray | float = 0.0) -> Shown:
    """What photos show of patches, ``radiance`` (N, VIEWS, 3)."""
    flat = radiance.reshape(-1, 3)
    flat = flat * np.random.default_rng(0).normal(1, 0.02, flat.shape)
    patch = np.repeat(np.arange(N), VIEWS)
    linear = radiance_itself(flat)
    mirrored = np.broadcast_to(np.asarray(specular), radiance.shape).reshape(-1, 3)
    return Shown(SimpleNamespace(patch=patch), linear, mirrored)  # type: ignore[arg-type]


def wall() -> np.ndarray:
    """Grey paint everywhere."""
    return np.full((N, VIEWS, 3), 0.4)


def with_pictures(of_view: list[np.ndarray], where: np.ndarray = ON_SCREEN) -> np.ndarray:
    radiance = wall()
    radiance[where] = np.stack(of_view)
    return radiance


CHANGING = [WHITE, CYAN] * (VIEWS // 2)


def test_a_surface_that_changes_and_is_too_bright_to_reflect_is_a_screen() -> None:
    (faces,) = find_screens(problem(), lit(), shown(with_pictures(CHANGING)))
    assert np.array_equal(faces, np.flatnonzero(ON_SCREEN))


def test_dark_areas_of_a_picture_belong_to_the_screen() -> None:
    dark = ON_SCREEN & (np.abs(MIDDLE[:, 0] - 1.4) < 0.05)
    radiance = with_pictures(CHANGING)
    radiance[dark] = 0.02
    (faces,) = find_screens(problem(), lit(), shown(radiance))
    assert np.array_equal(faces, np.flatnonzero(ON_SCREEN))


@pytest.mark.parametrize(
    ("of_view", "what"),
    [
        ([WHITE] * VIEWS, "a steady lamp, which the search finds by its brightness"),
        ([RED, 0.5 * CYAN] * (VIEWS // 2), "a page that was turned, no brighter than paint"),
        ([WHITE, 0.3 * WHITE] * (VIEWS // 2), "a highlight on white lacquer"),
        ([CYAN] + [RED] * (VIEWS - 1), "a reflection that one view in eight has"),
    ],
)
def test_steady_light_pages_highlights_and_rare_reflections_are_no_screen(of_view: list[np.ndarray], what: str) -> None:
    assert find_screens(problem(), lit(), shown(with_pictures(of_view))) == [], what


def test_a_mirror_image_is_no_screen() -> None:
    radiance = with_pictures(CHANGING)
    mirrored = radiance - 0.3
    assert find_screens(problem(), lit(), shown(radiance, np.where(ON_SCREEN[:, None, None], mirrored, 0.0))) == []


def test_specks_far_apart_or_off_a_plane_are_no_screen() -> None:
    rng = np.random.default_rng(1)
    specks = ~ON_SCREEN & (rng.random(N) < 0.01)
    assert specks.sum() > screens.SCREEN_MIN_PATCHES
    assert find_screens(problem(), lit(), shown(with_pictures(CHANGING, specks))) == []


def test_a_drift_of_white_balance_makes_no_screens() -> None:
    """Every photo has a tint of its own, so bright surfaces change as everything does."""
    tint = np.exp(np.random.default_rng(2).normal(0, 0.3, (VIEWS, 3)))
    radiance = with_pictures([WHITE] * VIEWS) * tint
    assert find_screens(problem(), lit(), shown(radiance)) == []
    radiance[ON_SCREEN, ::2] *= np.array([0.1, 1, 3])
    assert len(find_screens(problem(), lit(), shown(radiance))) == 1


def test_a_known_lamp_is_not_found_again_as_a_screen() -> None:
    lights = replace(lit(), mask=ON_SCREEN)
    assert find_screens(problem(), lights, shown(with_pictures(CHANGING))) == []


@pytest.mark.parametrize(("loss", "stays"), [(1.001, True), (1.02, False)])
def test_a_screen_is_kept_unless_it_raises_the_held_out_loss(
    monkeypatch: pytest.MonkeyPatch, loss: float, stays: bool
) -> None:
    weights = []

    def solve(_problem, _observed, emitters, before, _progress, _factors, fit, *_args, **_kwargs):
        weights.append(fit.weight)
        held_out = loss if len(emitters) else 1.0
        return replace(before, emitters=emitters, held_out=held_out)

    monkeypatch.setattr(screens, "form_factors_of", lambda *_args, **_kwargs: None)
    monkeypatch.setattr(screens, "solve_lights", solve)
    observed: GroupRadiance = SimpleNamespace()  # type: ignore[assignment]
    weight = np.ones(N)
    picture = shown(with_pictures(CHANGING))
    found = with_screens(problem(), observed, lit(), picture, weight, np.ones((N, 3)), Progress())
    assert len(found.emitters) == stays
    for weight in weights:  # the same patches with and without the screen, and none on it
        assert np.array_equal(weight, np.where(ON_SCREEN, 0.0, 1.0))


def test_a_screen_is_brighter_than_paint_in_a_quarter_of_the_views() -> None:
    """A reflectance of SCREEN_MIN_REFLECTANCE in the brightest channel of a quarter of the views."""
    picture = CYAN * SCREEN_MIN_REFLECTANCE / CYAN.max()
    for factor, found in ((1.15, 1), (0.85, 0)):
        views = [factor * picture] * (VIEWS // 2) + [RED] * (VIEWS // 2)
        assert len(find_screens(problem(), lit(), shown(with_pictures(views)))) == found
