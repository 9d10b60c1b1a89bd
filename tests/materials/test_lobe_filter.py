"""The filter over neighbouring pixels removes the noise of specular lobes, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.materials.specular import denoise_lobes
from iris_addon.model.capture import Camera
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from tests.box_room import look_at
from tests.engine_room import assemble, quad

WIDTH, HEIGHT = 96, 72


def floor_seen_by(width: int) -> tuple[Camera, PixelSamples]:
    """A camera that looks down on a floor of 20 m, and its pixels."""
    mesh = assemble([quad([-10, -10, 0], [20, 0, 0], [0, 20, 0])], [0])
    pose = look_at(np.array([0, 0, 1.5]), np.array([2.0, 0, 0]))
    camera = Camera(
        width=width,
        height=width * HEIGHT // WIDTH,
        fx=width,
        fy=width,
        cx=width / 2,
        cy=width * HEIGHT / WIDTH / 2,
        c2w=pose,
    )
    return camera, trace_pixels(Tracer(mesh), [camera], Progress())


def filtered(camera: Camera, samples: PixelSamples, lobes: np.ndarray, roughness: float, **columns) -> np.ndarray:
    n = len(samples.face)
    region = columns.get("region", np.zeros(n, np.int32))
    return denoise_lobes(lobes.astype(np.float32), samples, np.arange(n), region, np.full(n, roughness), [camera])


def test_the_filter_removes_noise_of_wide_lobes_and_keeps_their_mean() -> None:
    camera, samples = floor_seen_by(WIDTH)
    noise = np.random.default_rng(0).exponential(1.0, (len(samples.face), 2))
    smooth = filtered(camera, samples, noise, 0.5)
    assert smooth.mean() == pytest.approx(noise.mean(), abs=0.02)
    assert smooth.std() < 0.2 * noise.std()
    assert filtered(camera, samples, np.ones_like(noise), 0.5) == pytest.approx(np.ones_like(noise))


def test_a_mirror_keeps_its_image() -> None:
    """A pattern over the reflected direction as fine as the lobe of a mirror allows stays, one finer than a wide lobe
    goes."""
    camera, samples = floor_seen_by(WIDTH)
    reflected = 2 * samples.cosine[:, None] * samples.normal - samples.direction
    stripes = np.sign(np.sin(60 * reflected[:, :1]))
    assert np.abs(filtered(camera, samples, stripes, 0.05) - stripes).mean() < 0.01
    assert np.abs(filtered(camera, samples, stripes, 0.5) - stripes).mean() > 0.2


def test_the_filter_stops_at_borders_of_regions() -> None:
    camera, samples = floor_seen_by(WIDTH)
    region = (samples.position[:, 1] > 0).astype(np.int32)
    lobes = region[:, None].astype(np.float64)
    assert filtered(camera, samples, lobes, 0.5, region=region) == pytest.approx(lobes, abs=1e-6)
