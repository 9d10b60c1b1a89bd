"""The tabulated directional albedo against brute force, and energy conservation."""

import numpy as np
import pytest

from iris_addon.brdf.ggx import directional_albedo, grazing_fresnel, smith_g1, specular_integrals


def brute_force(roughness: float, cosine: float, n: int = 400_000) -> tuple[float, float]:
    """The same integrals with uniformly distributed incoming directions: no importance sampling to get wrong."""
    random = np.random.default_rng(1)
    z, phi = random.random(n), random.random(n) * 2 * np.pi
    r = np.sqrt(1 - z**2)
    incoming = np.stack([r * np.cos(phi), r * np.sin(phi), z], -1)
    outgoing = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    half = incoming + outgoing
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    alpha = roughness**2
    d = alpha**2 / (np.pi * ((half[:, 2] ** 2) * (alpha**2 - 1) + 1) ** 2)
    g = smith_g1(z, alpha) * smith_g1(np.array(cosine), alpha)
    f1 = grazing_fresnel(half @ outgoing)
    weight = 2 * np.pi * d * g / (4 * z * cosine) * z
    return float(np.mean(weight * (1 - f1))), float(np.mean(weight * f1))


@pytest.mark.parametrize("roughness", [0.3, 0.55, 1.0])
@pytest.mark.parametrize("cosine", [0.25, 0.6, 1.0])
def test_table_equals_brute_force(roughness: float, cosine: float) -> None:
    f0, f1 = specular_integrals(np.array([roughness]), np.array([cosine]))
    expected_f0, expected_f1 = brute_force(roughness, cosine)
    assert f0[0] == pytest.approx(expected_f0, abs=0.01)
    assert f1[0] == pytest.approx(expected_f1, abs=0.005)


def test_specular_albedo_is_at_most_one() -> None:
    roughness, cosine = np.meshgrid(np.linspace(0, 1, 50), np.linspace(0, 1, 50))
    f0, f1 = specular_integrals(roughness, cosine)
    assert (f0 >= 0).all() and (f1 >= 0).all()
    assert (f0 + f1).max() <= 1 + 1e-9


def test_smooth_metal_reflects_its_colour_head_on() -> None:
    color = np.array([0.9, 0.6, 0.3])
    assert directional_albedo(color, 0.05, 1.0, 1.0) == pytest.approx(color, abs=0.01)


def test_a_dielectric_follows_snell_and_fresnel() -> None:
    """Of IOR 1.5: 4 % head-on, all at grazing, and at Brewster's angle half of what the one polarisation reflects."""
    brewster = 1 / np.sqrt(1 + 1.5**2)
    across = ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
    f1 = grazing_fresnel(np.array([1.0, brewster, 0.0]))
    assert 0.04 * (1 - f1) + f1 == pytest.approx([0.04, across / 2, 1.0], abs=1e-12)
