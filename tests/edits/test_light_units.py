"""Lumens and kelvin of lamps against closed forms."""

import json
from pathlib import Path

import numpy as np
import pytest

from iris_addon.edits.light_units import (
    METERED_STOPS,
    METERED_VALUE,
    XYZ,
    flux,
    illuminance,
    kelvin,
    metered_scale,
    planckian,
)
from iris_addon.model.response import LUMINANCE, gamma
from iris_addon.model.sphere import equirect_directions
from iris_addon.results.folder import load_result

ASSETS = Path(__file__).resolve().parents[2] / "assets"
TRUTH = "demo_room/gt/emitters.json"


def test_flux_of_a_lambertian_square():
    assert flux((2.0, 2.0, 2.0), 0.5) == pytest.approx(np.pi)  # pi L A
    assert flux((0.0, 1.0, 0.0), 1.0) == pytest.approx(np.pi * 0.7152)


@pytest.mark.parametrize("temperature", [2700, 4000, 5000, 6504, 9000])
def test_a_black_body_has_its_own_temperature(temperature):
    x, y = planckian(temperature)
    color = np.linalg.inv(XYZ) @ (x / y, 1.0, (1 - x - y) / y)
    assert kelvin(color) == pytest.approx(temperature, rel=0.02)
    assert kelvin(7.0 * color) == pytest.approx(kelvin(color))


def test_white_of_the_display_is_daylight():
    assert kelvin((1, 1, 1)) == pytest.approx(6504, rel=0.01)


@pytest.mark.parametrize("color", [(0, 0, 0), (0, 1, 0), (1, 0, 1), (0, 0, 1)])
def test_no_black_body_has_a_saturated_color(color):
    assert kelvin(color) is None


def test_lamps_of_the_solved_demo_have_the_kelvin_and_once_one_is_anchored_the_lumens_that_they_have():
    """The scale of a room without known exposures is that of its anchor; colors and ratios are what was recovered."""
    true = {lamp["area"]: np.array(lamp["radiance"]) for lamp in json.loads((ASSETS / TRUTH).read_text())}
    recovered = load_result(ASSETS / "demo_solved").emitters
    assert len(recovered) == len(true)
    brighter = []
    for lamp in recovered:
        area = min(true, key=lambda each: abs(each - lamp.area))
        assert kelvin(lamp.radiance) == pytest.approx(kelvin(true[area]), rel=0.03)
        brighter.append(flux(lamp.radiance, lamp.area) / flux(true[area], area))
    assert max(brighter) / min(brighter) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, -0.8)])
def test_a_meter_reads_pi_times_the_radiance_of_even_surroundings(normal):
    even = np.broadcast_to([1.0, 2.0, 3.0], (128, 256, 3))
    assert illuminance(even, normal) == pytest.approx(np.pi * LUMINANCE @ (1, 2, 3), rel=1e-3)


def test_a_meter_reads_a_round_lamp_by_the_square_of_its_sine_and_not_what_is_behind_it():
    """A disc of half angle θ straight before the meter gives π L sin²θ (Lambert)."""
    directions = equirect_directions(1024, 512)
    lamp = (directions[..., 0] > np.cos(0.3)) * 5.0
    panorama = np.repeat(lamp[..., None], 3, axis=2)
    assert illuminance(panorama, (1, 0, 0)) == pytest.approx(np.pi * 5 * np.sin(0.3) ** 2, rel=0.01)
    assert illuminance(panorama, (-1, 0, 0)) == 0


def test_photos_of_several_exposures_say_one_scale_and_how_far_they_disagree():
    """A gray of 40 cd/m² is 0.2 in the unit of the solve; a camera set for it shows it at code 118."""
    response = gamma()
    x = response.invert(np.full(3, METERED_VALUE))
    balance = np.array([1.0, 1.0, 1.0])
    photos = [(response, x / 0.2 * balance * 2.0**stop, 40.0 / 2.0**stop) for stop in (-2, 0, 1)]
    scale, stops = metered_scale(photos)
    assert scale == pytest.approx(200) and stops == pytest.approx(METERED_STOPS)
    photos[1] = (response, photos[1][1], 80.0)  # twice as bright by its EXIF
    scale, stops = metered_scale(photos)
    assert scale == pytest.approx(200 * 2 ** (1 / 3)) and stops > METERED_STOPS + 0.1
