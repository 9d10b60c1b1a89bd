"""Irradiance between patches: noise goes, the edges of light stay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.rays.tracer import Tracer
from iris_addon.surface.irradiance import IrradianceField
from iris_addon.surface.patches import Surface, build_surface
from iris_addon.surface.primary_rays import PixelSamples, trace_pixels
from tests.engine_room import cameras, furnished_room


@dataclass(frozen=True)
class Scene:
    """Pixels and patches of the furnished room."""

    samples: PixelSamples
    surface: Surface


@pytest.fixture(scope="module")
def scene() -> Scene:
    room = furnished_room()
    samples = trace_pixels(Tracer(room.mesh), cameras(12), Progress())
    return Scene(samples, build_surface(room.mesh, samples, room.regions, 4000, np.random.default_rng(0)))


def test_smoothing_keeps_a_constant_and_reduces_noise(scene: Scene) -> None:
    field = IrradianceField.build(scene.surface)
    constant = np.tile([1.0, 2.0, 3.0], (len(scene.surface.region), 1))
    assert field.kernel(1.0) @ constant == pytest.approx(constant, rel=1e-5)
    assert field.at_samples(scene.samples, scene.surface.sample_patch, constant) == pytest.approx(
        constant[scene.surface.sample_patch], rel=1e-5
    )
    noise = np.random.default_rng(0).normal(0, 1, (len(constant), 1))
    assert (field.kernel(1.0) @ noise).std() < 0.6


def test_means_over_one_albedo_keep_the_light_balance(scene: Scene) -> None:
    """L = a I with any I: both sides averaged alike within a group of one albedo still have the quotient a."""
    field, rng = IrradianceField.build(scene.surface), np.random.default_rng(0)
    group = rng.integers(0, 3, len(scene.surface.region))
    albedo, irradiance = np.array([0.1, 0.5, 0.9])[group][:, None], rng.random((len(group), 3)) + 0.1
    rows = np.flatnonzero(rng.random(len(group)) < 0.3)
    reflected, arriving = (field.kernel(1.0, rows, group) @ values for values in (albedo * irradiance, irradiance))
    assert reflected / arriving == pytest.approx(np.tile(albedo[rows], 3), rel=1e-4)


def test_irradiance_does_not_leak_around_corners(scene: Scene) -> None:
    field = IrradianceField.build(scene.surface)
    upward = (scene.surface.normal[:, 2:] > 0.5).astype(np.float64)
    leak = np.abs(field.kernel(1.0) @ upward - upward)
    assert leak.max() < 0.02


def _two_panes(size: float = 0.05) -> tuple[IrradianceField, np.ndarray]:
    """The field of two parallel squares of 1 m, 6 cm apart, that face the same way; and which patches lie behind."""
    ticks = np.arange(0, 1, size)
    x, z, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks, [0.0, 0.06], indexing="ij"))
    normal = np.tile(np.float32([0, -1, 0]), (len(x), 1))
    position = np.stack([x, y, z], 1).astype(np.float32)
    return IrradianceField.of(position, normal, np.full(len(x), size, np.float32)), y > 0


def test_irradiance_does_not_leak_from_a_pane_to_the_frame_before_it() -> None:
    field, behind = _two_panes()
    lit = np.tile(np.where(behind, 2.5, 0.3)[:, None], 3)
    assert field.denoise(lit) == pytest.approx(lit, rel=1e-3)
    assert field.kernel(1.0) @ lit == pytest.approx(lit, rel=0.01)  # which does not know the light
    extreme = lit * np.where(behind, 1e6, 0.0)[:, None]
    assert field.denoise(extreme) == pytest.approx(extreme, rel=1e-3)


def test_denoising_keeps_the_edge_of_a_shadow() -> None:
    field, _ = _two_panes()
    shadow = field.position[:, 0] < 0.5
    clean = np.tile(np.where(shadow, 0.2, 0.8)[:, None], 3)
    noise = np.random.default_rng(0).normal(1, 0.05, (len(clean), 1))
    error = np.log(field.denoise(clean * noise) / clean)
    assert error.std() < 0.5 * np.log(noise).std()
    assert abs(error[shadow].mean()) < 0.005 and abs(error[~shadow].mean()) < 0.005
    assert np.abs(np.log(field.kernel(1.0) @ clean / clean)).max() > 0.1
