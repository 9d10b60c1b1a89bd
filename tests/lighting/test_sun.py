"""A room whose sunlight is known in closed form: what passes a window in the plane y = 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.lighting.search import choose_outside
from iris_addon.lighting.sun import Sun
from iris_addon.lighting.sun_choice import choose_sun, with_sun
from iris_addon.materials.shading import Shading
from iris_addon.surface.photo_samples import ShownPixels
from tests.engine_room import quad
from tests.light_room import CEILING_LAMP, LitRoom, Panel, light_room, panels

SOUTH = 2
WINDOW = np.array([[1.2, 0.8], [2.8, 2.1]])
"""From (x, z) to (x, z) in the wall y = 0, metres."""
TOWARD_SUN = np.array([0.35, -0.72, 0.6]) / np.linalg.norm([0.35, -0.72, 0.6])
IRRADIANCE = 30.0
LAMP = 6
WEST_PANEL: Panel = ([3.95, 0.8, 0.9], [0, 1.2, 0], [0, 0, 0.9])
NORTH_PANEL: Panel = ([1.4, 2.95, 0.9], [1.2, 0, 0], [0, 0, 0.9])


def sunlight(position: np.ndarray, normal: np.ndarray, toward: np.ndarray = TOWARD_SUN) -> np.ndarray:
    """(n,) irradiance / pi of a sun of IRRADIANCE through the window."""
    leaves = position + (position[:, 1:2] / -toward[1]) * toward
    inside = ((leaves[:, [0, 2]] > WINDOW[0]) & (leaves[:, [0, 2]] < WINDOW[1])).all(1) & (position[:, 1] > 1e-3)
    return IRRADIANCE / np.pi * inside * np.maximum(normal @ toward, 0)


def window_room(sun: bool, lamp: float = 0.0, clip: float = np.inf, panel: Panel = CEILING_LAMP) -> LitRoom:
    """The box room with a window in the south, a sky of radiance 1, and ``panel`` for a lamp if it shines."""
    pieces, regions, albedo = panels(panel)
    (x0, z0), (x1, z1) = WINDOW
    kept = [k for k, region in enumerate(regions) if region != SOUTH and (lamp or region != LAMP)]
    around = [
        quad([0, 0, 0], [x0, 0, 0], [0, 0, 2.5], 0.25),
        quad([x1, 0, 0], [4 - x1, 0, 0], [0, 0, 2.5], 0.25),
        quad([x0, 0, 0], [x1 - x0, 0, 0], [0, 0, z0], 0.25),
        quad([x0, 0, z1], [x1 - x0, 0, 0], [0, 0, 2.5 - z1], 0.25),
    ]
    return light_room(
        [*(pieces[k] for k in kept), *around],
        [*(regions[k] for k in kept), *[SOUTH] * 4],
        albedo,
        {LAMP: lamp} if lamp else {},
        sky=1.0,
        clip=clip,
        direct=sunlight if sun else None,
    )


def shown(room: LitRoom, sun: bool, clip: float = np.inf) -> ShownPixels:
    """Photos of the room with the borders of its sunlight sharp."""
    samples, patch = room.problem.samples, room.problem.surface.sample_patch
    albedo, direct = room.room.albedo[room.problem.regions[samples.face]], np.zeros(len(patch))
    if sun:
        direct = sunlight(samples.position, samples.normal)
    mean = np.bincount(patch, direct) / np.bincount(patch)
    luminance = (room.radiance[patch] + albedo * (direct - mean[patch])[:, None]).mean(1)
    clipped = luminance > clip
    return ShownPixels(np.minimum(luminance, clip).astype(np.float32), clipped, np.ones(len(patch), bool))


def found(room: LitRoom, sun: bool, clip: float = np.inf) -> Sun | None:
    return with_sun(room.problem, room.observed, shown(room, sun, clip), Progress()).hidden.sun


@pytest.mark.parametrize("clip", [np.inf, 3.0])
def test_the_sun_is_found_where_it_stands_and_as_strong_as_it_is(clip: float) -> None:
    """Also where all photos clip its patch of light on the white wall, and only some of the floor's."""
    sun = found(window_room(sun=True, clip=clip), True, clip)
    assert sun is not None
    assert np.degrees(np.arccos(sun.direction @ TOWARD_SUN)) < 2.0
    assert sun.irradiance == pytest.approx(np.full(3, IRRADIANCE), rel=0.1)


def test_sunlight_that_clips_in_all_photos_is_known_by_the_light_it_passes_on() -> None:
    """No photo measures a sunlit place. Of patches that sunlight covers in part, photos measure the darker part."""
    room, clip = window_room(sun=True), 1.0
    pixels, patch = shown(room, True, clip), room.problem.surface.sample_patch
    dark = np.where(pixels.clipped, 0.0, 1.0)
    count = np.bincount(patch, dark)
    level = np.bincount(patch, dark * pixels.luminance) / np.maximum(count, 1)
    touched = np.bincount(patch, pixels.clipped) > 0
    radiance = np.where(count > 0, np.where(touched, level, room.observed.radiance[:, 0]), clip)[:, None].repeat(3, 1)
    known, bound = (count > 0)[:, None].repeat(3, 1), np.where(touched, clip, 0.0)[:, None].repeat(3, 1)
    assert (touched & known[:, 0]).sum() > 10
    observed = replace(room.observed, radiance=radiance, known=known, bound=bound)
    problem = with_sun(room.problem, observed, pixels, Progress())
    assert problem.hidden.sun is not None
    problem, lights = choose_outside(problem, observed, Progress())
    assert not lights.emitters
    assert lights.hidden_radiance[-1] == pytest.approx(np.full(3, IRRADIANCE), rel=0.2)


def test_what_the_sun_lights_is_no_lamp() -> None:
    room = window_room(sun=True)
    _, problem, lights = choose_sun(room.problem, room.observed, shown(room, True), Progress())
    assert not lights.emitters and problem.hidden.sun is not None
    assert lights.hidden_radiance[-1] == pytest.approx(np.full(3, IRRADIANCE), rel=0.1)


@pytest.mark.parametrize(("panel", "lamp", "clip"), [(WEST_PANEL, 6.0, 3.0), (NORTH_PANEL, 60.0, 1.0)])
def test_a_lamp_that_clips_with_what_it_lights_is_no_sunlit_wall(panel: Panel, lamp: float, clip: float) -> None:
    """Through the window a sun could shine on it."""
    room = window_room(sun=False, lamp=lamp, clip=clip, panel=panel)
    problem, _, lights = choose_sun(room.problem, room.observed, shown(room, False, clip), Progress())
    assert problem.hidden.sun is None
    assert room.lamps(lights) >= {LAMP}


@pytest.mark.parametrize("lamp", [0.0, 20.0])
def test_no_sun_is_found_in_a_room_without_one(lamp: float) -> None:
    room = window_room(sun=False, lamp=lamp)
    problem, _, _ = choose_sun(room.problem, room.observed, shown(room, False), Progress())
    assert problem.hidden.sun is None


def test_irradiance_of_pixels_has_the_sharp_borders_of_sunlight() -> None:
    """Between patches it is interpolated; the border of sunlight goes through them."""
    room = window_room(sun=True)
    problem = with_sun(room.problem, room.observed, shown(room, True), Progress())
    problem, lights = choose_outside(problem, room.observed, Progress())
    samples, patch = problem.samples, problem.surface.sample_patch
    light = Shading.under(lights, problem, "lambert").at_pixels(problem, lights).mean(1)
    true, sun = sunlight(samples.position, samples.normal), problem.hidden.sun
    assert sun is not None
    on_border = (np.bincount(patch, true > 0) / np.bincount(patch) % 1 > 0)[patch]
    lit, dark = on_border & (sun.visible == 1), on_border & (sun.visible == 0)
    assert np.mean(true[lit] > 0) > 0.95 and np.mean(true[dark] == 0) > 0.95
    ambient = np.median(light[dark])
    assert np.median(light[lit] / (true[lit] + ambient)) == pytest.approx(1, abs=0.1)
    assert ambient < 0.1 * np.median(light[lit])
