"""Observations of curved surfaces stand for one pixel, of flat ones for all their pixels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from iris_addon.materials.view_dependence import mirrored_radiance, on_curved_surface
from iris_addon.model import response as curve
from iris_addon.response.observations import Observations
from iris_addon.response.photometry import Photometry
from iris_addon.response.radiance import Linearised, group_radiance, radiance_itself
from iris_addon.surface.photo_samples import PhotoSamples

VIEWS, PIXELS = 3, 4


def _observed(turn: float) -> tuple[Observations, Linearised, PhotoSamples]:
    """Per view two observations of as many pixels, whose normals are ``turn`` degrees apart in the second one; the
    radiance of pixel i is i."""
    n = VIEWS * 2 * PIXELS
    group = np.repeat(np.arange(VIEWS * 2, dtype=np.int32), PIXELS)
    angle = np.radians(turn) * (np.arange(n) % PIXELS) * (group % 2)
    normal = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1).astype(np.float32)
    z = np.repeat(np.arange(n, dtype=np.float32)[:, None], 3, 1)
    view = (group // 2).astype(np.int16)
    mean = z.reshape(-1, PIXELS, 3).mean(1)
    m = len(mean)
    sample = np.arange(m) * PIXELS  # the first pixel of each
    observations = Observations(
        patch=np.tile(np.arange(2, dtype=np.int32), VIEWS),
        view=view[::PIXELS],
        count=np.full(m, PIXELS, np.float32),
        z=mean,
        spread=0 * mean,
        saturated=0 * mean,
        black=0 * mean,
        sample=sample,
        pixel=np.zeros(m, np.int32),
        sample_to_observation=group,
    )
    linear = radiance_itself(mean.astype(np.float64))
    samples = SimpleNamespace(normal=normal, view=view, pixel=np.zeros(n, np.int32))
    return observations, linear, cast(PhotoSamples, SimpleNamespace(samples=samples, z=z))


@pytest.mark.parametrize("turn", [0.0, 1.0, 20.0])
def test_curved_surfaces_are_found_by_their_normals(turn: float) -> None:
    observations, _, photos = _observed(turn)
    found = on_curved_surface(observations, photos.samples.normal)
    assert not found[::2].any()
    assert (found[1::2] == (turn > 5)).all()


def test_radiance_on_a_curved_mirror_is_that_of_one_pixel() -> None:
    observations, linear, photos = _observed(20.0)
    observed = group_radiance(linear, observations.patch, observations.count, 2)
    exposures = np.array([1.0, 2.0, 4.0])[:, None].repeat(3, 1)
    photometry = Photometry(
        response=curve.identity(), exposures=exposures, held_out=np.nan, per_channel=False, known_exposures=True
    )
    radiance = mirrored_radiance(observations, linear, observed, photos, photometry)
    np.testing.assert_array_equal(radiance[::2], linear.radiance[::2])
    own = photos.z[observations.sample[1::2]]
    np.testing.assert_allclose(radiance[1::2], own / exposures)
