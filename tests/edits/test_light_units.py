"""Lumens and kelvin of lamps against closed forms."""

import json
from pathlib import Path

import numpy as np
import pytest

from iris_addon.edits.light_units import XYZ, flux, kelvin, planckian
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
