"""The exposure of a picture against a render of its room: what may stand in the picture without moving it."""

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.blender.synth.photos import develop, film
from iris_addon.model.capture import Photo
from iris_addon.model.response import gamma
from iris_addon.response.matching import match_exposure

EXPOSURE = np.array([0.3, 0.36, 0.42])


def room(seed=0):
    """Radiance of a picture with dark corners, grey walls and a lamp that clips, and the solved room's error on it."""
    rng = np.random.default_rng(seed)
    truth = np.exp(rng.normal(0.0, 0.8, (40, 60, 1))) * np.array([1.0, 0.9, 0.8])
    truth[:6, :10] = 30.0
    return truth, truth * np.exp(rng.normal(0.0, 0.1, truth.shape))


def photo(radiance, exposure, response, hdr=False):
    values = radiance * exposure if hdr else develop(radiance, exposure, response) / np.float32(255)
    return Photo(values.astype(np.float32), np.ones(radiance.shape[:2], bool), hdr)


@pytest.mark.parametrize("response", [film(), gamma()], ids=["film", "gamma"])
@pytest.mark.parametrize("stops", [-3.0, 0.0, 2.0])
def test_the_exposure_is_found_within_two_percent(response, stops):
    truth, solved = room()
    exposure = EXPOSURE * 2.0**stops
    np.testing.assert_allclose(match_exposure(solved, photo(truth, exposure, response), response), exposure, rtol=0.02)


def test_somebody_who_walks_through_the_picture_does_not_change_the_exposure():
    """A third of the picture shows a red coat that the solved room does not have."""
    truth, solved = room()
    truth[:, 20:40] = [1.5, 0.1, 0.1]
    np.testing.assert_allclose(match_exposure(solved, photo(truth, EXPOSURE, film()), film()), EXPOSURE, rtol=0.02)


def test_pictures_of_radiance_are_matched_in_their_own_unit():
    truth, solved = room()
    found = match_exposure(solved, photo(truth, 40 * EXPOSURE, film(), hdr=True), film())
    np.testing.assert_allclose(found, 40 * EXPOSURE, rtol=0.02)


def test_local_exposure_is_taken_into_account():
    truth, solved = room()
    places = np.linspace(0.3, 1.0, 60)[None, :, None]
    found = match_exposure(solved, photo(truth * places, EXPOSURE, film()), film(), places)
    np.testing.assert_allclose(found, EXPOSURE, rtol=0.02)


@pytest.mark.parametrize("factor", [0.0, 1e6])
def test_a_picture_that_is_black_or_white_has_no_exposure(factor):
    truth, solved = room()
    with pytest.raises(BadInput, match="neither black nor clipped"):
        match_exposure(solved, photo(truth, factor * EXPOSURE, film()), film())
