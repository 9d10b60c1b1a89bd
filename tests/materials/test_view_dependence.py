"""Diffuse lobes: the product against Burley's exact lobe, energy between patches, and the choice from photos."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.brdf.diffuse import MEAN_SCHLICK, albedo_gain, grazing_gain, schlick, under_lobe
from iris_addon.decide import Decisions
from iris_addon.lighting.hidden import nothing_hidden
from iris_addon.lighting.problem import LightProblem, Lights
from iris_addon.materials.shading import light_moments
from iris_addon.materials.view_dependence import choose_diffuse
from iris_addon.rays.sampling import Origins
from iris_addon.rays.tracer import Tracer
from iris_addon.response.observations import Observations
from iris_addon.response.radiance import radiance_itself
from iris_addon.surface.irradiance import IrradianceField
from iris_addon.transport.form_factors import emitter_form_factors
from iris_addon.transport.gather import ESCAPED, UNKNOWN, gather
from iris_addon.transport.transport import LightMoments, sent_back
from tests.engine_room import assemble, cameras, furnished_room, patched, quad


def burley_directional_albedo(roughness: float, cosine: float, n: int = 200_000) -> float:
    """What a white surface with Burley's exact lobe sends along ``cosine`` under uniform light of radiance 1."""
    u = np.random.default_rng(1).random((n, 2))
    radius, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    light = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - u[:, 0])], -1)
    view = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gain = 2 * roughness * (half @ view) ** 2 - 0.5
    return float(np.mean((1 + gain * (1 - light[:, 2]) ** 5) * (1 + gain * (1 - cosine) ** 5)))


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("cosine", [0.15, 0.4, 0.7, 0.95])
def test_the_product_is_burleys_lobe_in_uniform_light(roughness: float, cosine: float) -> None:
    product = albedo_gain("burley", np.array(roughness), np.array(cosine))
    assert product == pytest.approx(burley_directional_albedo(roughness, cosine), rel=0.03)


def test_mean_schlick_is_the_cosine_weighted_mean() -> None:
    c = (np.arange(100_000) + 0.5) / 100_000
    assert np.mean(2 * c * schlick(c)) == pytest.approx(MEAN_SCHLICK, rel=1e-4)


def test_a_lambertian_patch_ignores_where_light_comes_from() -> None:
    assert np.all(grazing_gain("lambert", np.linspace(0, 1, 5)) == 0)
    factors = np.random.default_rng(0).random((4, 3, 2))
    np.testing.assert_allclose(under_lobe(factors, np.zeros(4)), factors[..., 0], rtol=1e-6)


def test_a_lamp_on_the_horizon_counts_for_its_schlick_factor() -> None:
    """A small lamp at one angle: the second form factor is the first times S of that angle."""
    for cosine in (0.2, 0.5, 0.9):
        sine = np.sqrt(1 - cosine**2)
        centre = 5 * np.array([sine, 0, cosine])
        lamp = quad(centre - [0, 0.1, 0.1], [0, 0.2, 0], [0, 0, 0.2])
        tracer, rng = Tracer(assemble([lamp], [0])), np.random.default_rng(0)
        up = np.tile(np.array([0, 0, 1], np.float32), (400, 1, 1))
        origins = Origins(np.zeros((400, 1, 3), np.float32), up)
        rays, _ = gather(tracer, origins, 16, rng, Progress())
        factors = emitter_form_factors(tracer, origins, rays, [np.arange(2)], 16, rng, Progress())[:, 0].mean(0)
        assert factors[1] / factors[0] == pytest.approx((1 - cosine) ** 5, rel=0.06)


def test_uniform_radiance_is_weighted_by_the_mean_of_both_lobes() -> None:
    """In a closed room of uniform radiance the rays carry the product of the lobes at both of their ends."""
    room = furnished_room()
    transport = patched(room, cameras(12), 2000, 64).transport
    n, none = transport.n_patches, np.zeros(len(room.regions), bool)
    ones, unknown = np.ones((n, 3)), np.ones(3)
    kappa = np.full(n, 0.64)
    lobed = replace(transport, kappa=kappa).gather_radiance(ones, unknown, none)
    flat = transport.gather_radiance(ones, unknown, none)
    np.testing.assert_allclose(flat, 1.0, rtol=1e-5)
    # S of the angles of arrival averages to about the same mean in a room of large walls; both factors multiply.
    start = transport.rays.schlick_start.astype(float).mean()
    assert start == pytest.approx(MEAN_SCHLICK, rel=0.03)
    both = (1 + 0.64 * transport.rays.schlick_start) * (1 + 0.64 * transport.rays.schlick_end * (transport.target >= 0))
    np.testing.assert_allclose(lobed[: transport.n_seen, 0], both.mean(1), rtol=2e-3)
    assert 1.02 < lobed.mean() < 1.12


def test_patches_reflect_more_towards_the_side_of_their_light() -> None:
    """Rays back to the light and across it against Burley's exact lobe; what is no seen patch knows no side."""
    transport = patched(furnished_room(), cameras(6, 20, 15), 800, 64).transport
    n, seen = transport.n_patches, transport.n_seen
    # All light 70 degrees off the normal, which is z here.
    light = unit(np.array([np.sin(1.22), 0, np.cos(1.22)]))
    grazing = float(schlick(light[2]))
    moments = LightMoments(
        np.tile(light, (seen, 1)).astype(np.float32),
        np.full(seen, grazing, np.float32),
        np.tile(grazing * light, (seen, 1)).astype(np.float32),
    )
    kappa = float(grazing_gain("burley", np.array(1.0)))
    lit = replace(transport, kappa=np.full(n, kappa), moments=moments)
    back, across = light, light * [-1, 1, 1]
    away = np.stack([back, across])
    k = 2 * (1 + away @ light) / 2 - 0.5
    exact = (1 + k * grazing) * (1 + k * schlick(away[:, 2])) / (1 + kappa * grazing)

    def sent_along(target: int) -> list[float]:
        return [sent_back(lit.lobes, target, schlick(v[2]), *-v) for v in away]

    sent = sent_along(0)
    np.testing.assert_allclose(sent, exact, rtol=0.02)
    assert sent[0] > 1.15 * sent[1]
    mean = 1 + kappa * schlick(away[:, 2])
    np.testing.assert_allclose(sent_along(n - 1), mean, rtol=1e-6)
    assert sent_along(UNKNOWN) == sent_along(ESCAPED) == [1, 1]


def unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("tilt", [0.0, 0.8, 1.3])
def test_moments_of_light_give_burleys_lobe_from_every_side(roughness: float, tilt: float) -> None:
    """Light from around one direction, up to near the horizon, seen from all around."""
    rng = np.random.default_rng(0)
    toward_lamp = np.array([np.sin(tilt), 0, np.cos(tilt)])
    light = unit(toward_lamp + 0.3 * rng.normal(size=(4000, 3)))
    light = light[light[:, 2] > 0.02]
    views = unit(rng.normal(size=(300, 3)))
    views = views[views[:, 2] > 0.15]
    s_light, s_view = schlick(light[:, 2]), schlick(views[:, 2])
    weight = light[:, 2] / light[:, 2].sum()  # radiance 1 everywhere: irradiance goes by the cosine
    moments = LightMoments((weight @ light)[None], np.array([weight @ s_light]), (weight * s_light)[None] @ light)
    k = roughness * (1 + views @ light.T) - 0.5
    exact = (1 + k * s_light) * (1 + k * s_view[:, None]) @ weight
    under_lobe_ = 1 + grazing_gain("burley", np.array(roughness)) * (weight @ s_light)
    patch = np.zeros(len(views), int)
    found = moments.view_factor(patch, np.array([roughness]), s_view, views) * under_lobe_
    np.testing.assert_allclose(found, exact, rtol=0.04, atol=0.01)
    mean_angle = (1 + grazing_gain("burley", np.array(roughness)) * s_view) * under_lobe_
    if roughness == 1 and tilt > 1:  # what the moments are for
        assert np.abs(mean_angle / exact - 1).max() > 4 * np.abs(found / exact - 1).max()


def test_moments_of_uniform_light_and_of_one_lamp_are_exact() -> None:
    """In uniform radiance those of the cosine-weighted hemisphere; under a lamp in the dark its direction."""
    room = furnished_room()
    seen_by_all = patched(room, cameras(12), 2000, 256)
    tracer, transport = seen_by_all.tracer, seen_by_all.transport
    n, seen = transport.n_patches, transport.n_seen
    field = IrradianceField.build(seen_by_all.surface)
    problem = cast(
        LightProblem,
        SimpleNamespace(transport=transport, hidden=nothing_hidden(transport), field=field, tracer=tracer),
    )
    nowhere = np.zeros(len(room.regions), bool)
    uniform = Lights(
        emitters=[],
        radiance=np.zeros((0, 3)),
        hidden_radiance=np.zeros((0, 3)),
        log_std=np.zeros(0),
        form_factors=np.zeros((n, 0, 2), np.float32),
        mask=nowhere,
        irradiance=np.ones((n, 3)),
        patch_radiance=np.ones((n, 3)),
    )
    moments = light_moments(problem, uniform)
    along = (moments.direction * field.normal).sum(1)
    assert np.median(along) == pytest.approx(2 / 3, abs=0.02)
    assert np.median(moments.grazing) == pytest.approx(MEAN_SCHLICK, rel=0.1)

    lamp = room.lamps()[0]
    factors = np.tile(np.array([0.01, 0.001], np.float32), (n, 1, 1))
    one = replace(
        uniform, emitters=[lamp], radiance=np.full((1, 3), 5.0), form_factors=factors, patch_radiance=np.zeros((n, 3))
    )
    moments = light_moments(problem, one)
    centre = np.average(tracer.corners[lamp].mean(1), axis=0, weights=tracer.areas[lamp])
    far = np.linalg.norm(centre - field.position, axis=1) > 1.5
    agree = (unit(centre - field.position) * unit(moments.direction)).sum(1)[far]
    assert agree.min() > 0.98
    np.testing.assert_allclose(moments.grazing[:seen], 0.1, rtol=1e-4)
    np.testing.assert_allclose(moments.grazing_direction, 0.1 * moments.direction, atol=1e-4)


@pytest.mark.parametrize("lobe", ["lambert", "burley"])
def test_the_lobe_is_chosen_from_the_views(lobe: str) -> None:
    rng = np.random.default_rng(0)
    patches, views = 800, 6
    patch = np.repeat(np.arange(patches), views).astype(np.int32)
    m = len(patch)
    s = schlick(rng.uniform(0.1, 1.0, m))
    albedo = np.exp(rng.normal(-1, 0.5, patches))[patch]
    radiance = albedo * (1 + grazing_gain(lobe, np.array(1.0)) * s) * np.exp(rng.normal(0, 0.03, m))  # type: ignore[arg-type]
    rgb = np.repeat(radiance[:, None], 3, 1)
    zeros = np.zeros((m, 3), np.float32)
    observations = Observations(
        patch=patch,
        view=np.tile(np.arange(views), patches).astype(np.int16),
        count=np.full(m, 9, np.float32),
        z=rgb.astype(np.float32),
        spread=zeros,
        saturated=zeros,
        black=zeros,
        sample=np.arange(m),
        pixel=np.zeros(m, np.int32),
        sample_to_observation=np.arange(m, dtype=np.int32),
    )
    linear = radiance_itself(rgb)
    chosen = choose_diffuse(observations, linear, s, Decisions())
    assert chosen.lobe == lobe
    assert (chosen.gain > 0.2) == (lobe == "burley")
