"""Lumens and kelvin of lamps against closed forms."""

import numpy as np
import pytest

from iris_addon.edits.light_units import XYZ, flux, kelvin, planckian


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
