"""The profile of a lamp: what it sends by angle, and that it sends as much as an even lamp."""

import numpy as np
import pytest

from iris_addon.model.lamp_profile import EVEN_PROFILE, FLUX_SHARES, PROFILE_DEGREES, LampProfile, profile_basis


@pytest.mark.parametrize("relative", [[1, 1, 1, 1, 1, 1], [9, 5, 2, 0.3, 0.1, 0.1], [0, 0, 1, 2, 4, 8]])
def test_a_profile_sends_the_flux_of_an_even_lamp(relative: list[float]) -> None:
    """∫ p(c) 2 c dc over the hemisphere is 1."""
    cosine = (np.arange(100_000) + 0.5) / 100_000
    profile = LampProfile.of(np.array(relative))
    assert np.mean(profile.at(cosine) * 2 * cosine) == pytest.approx(1, rel=1e-4)
    np.testing.assert_allclose(profile.values / profile.values.max(), np.array(relative) / max(relative))


def test_it_is_linear_in_the_angle_constant_beyond_and_alike_on_both_sides() -> None:
    profile = LampProfile(np.array([6.0, 5, 4, 3, 2, 1]))
    degrees = np.array([0, 7.5, 15, 70, 75, 80, 89])
    np.testing.assert_allclose(profile.at(np.cos(np.radians(degrees))), [6, 5.5, 5, 4 / 3, 1, 1, 1])
    np.testing.assert_allclose(profile.at(-np.cos(np.radians(degrees))), profile.at(np.cos(np.radians(degrees))))
    assert profile.at(np.array([1.0000001, -1.0000001])).tolist() == [6, 6], "rounding may pass 1"


def test_the_beam_is_where_half_of_the_intensity_is_left() -> None:
    assert LampProfile(EVEN_PROFILE).beam_angle == pytest.approx(120, abs=0.3)
    narrow = LampProfile(np.array([1.0, 0.55, 0.1, 0.0, 0.0, 0.0]))
    degrees = np.linspace(0, 30, 3001)  # where this radiance is 1 − 0.03 per degree
    half = degrees[np.argmin(np.abs(np.cos(np.radians(degrees)) * (1 - 0.03 * degrees) - 0.5))]
    assert narrow.beam_angle == pytest.approx(2 * half, abs=0.3)
    bright_at_the_side = LampProfile(np.array([0.2, 0.2, 0.2, 1.0, 0.2, 0.2]))
    assert bright_at_the_side.beam_angle > 90


def test_the_parts_of_a_profile_add_up() -> None:
    cosine = np.linspace(-1, 1, 1001)
    profile = LampProfile(np.array([6.0, 5, 4, 3, 2, 1]))
    np.testing.assert_allclose(profile_basis(cosine).sum(-1), 1)
    np.testing.assert_allclose(profile_basis(cosine) @ profile.values, profile.at(cosine), atol=1e-12)
    assert FLUX_SHARES.sum() == pytest.approx(1) and len(FLUX_SHARES) == len(EVEN_PROFILE) == len(PROFILE_DEGREES)
