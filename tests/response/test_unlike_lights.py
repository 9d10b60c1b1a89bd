"""Photos of two lights that pass for one are told apart; whatever else sets photos apart is not taken for light."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.decide import REFINEMENTS, Decisions
from iris_addon.model.light_states import LightStates
from iris_addon.model.response import Response, gamma
from iris_addon.response import unlike_lights
from iris_addon.response.observations import Observations
from iris_addon.response.unlike_lights import UnlikeLights, find_unlike_lights
from tests.engine_room import observe_off_edges

PATCHES, PHOTOS = 600, 14
PLACE = np.linspace(0, 1, PATCHES)
LAMPS = np.array([np.exp(-3 * PLACE), np.exp(-3 * (1 - PLACE))])
"""Irradiance by a lamp at either end of the room."""
NAMES = [f"photo {k:02d}" for k in range(PHOTOS)]
SPLIT = np.arange(PHOTOS) % 3 == 0
"""Photos of the second light."""


def photographed(
    share: np.ndarray, response: Response | None = None, gloss: float = 0.0, noise: float = 0.01
) -> Observations:
    """Even patches in photos of different exposure from all along the room.

    Args:
        share: (V,) of the light that the first lamp gives.
        gloss: log luminance that highlights change, which move along the room with the camera.
        noise: standard deviation of log luminance.
    """
    rng = np.random.default_rng(0)
    albedo = rng.uniform(0.2, 0.8, (PATCHES, 1)) * rng.uniform(0.8, 1, (PATCHES, 3))
    patch, view = (a.ravel() for a in np.meshgrid(np.arange(PATCHES), np.arange(PHOTOS), indexing="ij"))
    light = share[view] * LAMPS[0, patch] + (1 - share[view]) * LAMPS[1, patch]
    camera = np.random.default_rng(1).permutation(PHOTOS) / PHOTOS
    light *= np.exp(gloss * np.sin(9 * (PLACE[patch] - camera[view]) + 40 * albedo[patch, 0]))
    light *= np.exp(noise * rng.normal(size=len(patch)))
    exposure = 2.0 ** rng.uniform(-1, 1, PHOTOS)
    exposed = np.clip(albedo[patch] * light[:, None] * exposure[view, None], 0, 1)
    z = np.floor(255 * (response or gamma()).apply(exposed)) / 255
    twice = np.repeat(np.arange(len(patch)), 2)  # pixels of each
    return observe_off_edges(patch[twice], view[twice], z[twice], rng)


def found_in(o: Observations, states: np.ndarray | None = None) -> list[UnlikeLights]:
    index = np.zeros(PHOTOS, np.int64) if states is None else states
    named = LightStates(tuple(f"state {k}" for k in range(int(index.max()) + 1)), index)
    return find_unlike_lights(o, NAMES, named, False, Decisions())


def mixed(contrast: float = 1.0) -> np.ndarray:
    """Shares of the first lamp in photos of two lights."""
    return np.where(SPLIT, 0.5 + contrast / 2, 0.5 - contrast / 2)


@pytest.mark.parametrize("response", [gamma(), gamma(0.35)])
def test_photos_of_two_lights_are_told_apart(response: Response) -> None:
    (found,) = found_in(photographed(mixed(), response, gloss=0.05))
    one, other = (set(names) for names in found.groups)
    second = {name for name, own in zip(NAMES, SPLIT, strict=True) if own}
    assert (one <= second) != (other <= second)
    assert not (one & second and one - second) and not (other & second and other - second)
    assert found.across > 3 * found.within
    assert "light_state" in found.warning and found.groups[0][0] in found.warning


def test_a_dimmed_lamp_is_another_light() -> None:
    assert found_in(photographed(mixed(contrast=0.5)))


@pytest.mark.parametrize(
    "disturbed",
    [{}, {"noise": 0.3}, {"gloss": 0.1}, {"response": gamma(0.3)}, {"gloss": 0.3, "noise": 0.2}],
    ids=["clean", "noise", "gloss", "response", "gloss and noise"],
)
def test_one_light_is_not_taken_for_two(disturbed: dict) -> None:
    assert not found_in(photographed(np.full(PHOTOS, 0.6), **disturbed))


def test_photos_whose_light_states_are_named_are_compared_within_each() -> None:
    o = photographed(mixed())
    assert not found_in(o, SPLIT.astype(np.int64))
    wrong = SPLIT.astype(np.int64)
    wrong[[0, 3, 6]] = 0  # three photos of the second light are named as of the first
    (found,) = found_in(o, wrong)
    assert {"photo 00", "photo 03", "photo 06"} in map(set, found.groups)


def test_two_ends_of_a_room_that_hardly_see_each_other_are_not_two_lights() -> None:
    """Of one light: three photos of either end see the glossy floor between them."""
    rng = np.random.default_rng(3)
    shown = np.full((PHOTOS, 1200), np.nan)
    for k in range(PHOTOS):
        shown[k, slice(0, 500) if k < PHOTOS // 2 else slice(700, 1200)] = 0.02 * rng.normal(size=500)
        if k < 3 or k >= PHOTOS - 3:
            shown[k, 500:700] = 0.2 * rng.normal(size=200)
    gains = [pair.gain for pair in unlike_lights.divisions(shown)]
    assert all(gain < REFINEMENTS["unlike_lights"].gain for gain in gains)


def test_few_photos_or_none_in_common_say_nothing() -> None:
    assert not found_in(photographed(mixed()).of_photos(np.arange(PHOTOS) < 4))
    assert np.isnan(unlike_lights.pair_scatter(np.full((3, 50), np.nan))).all()
