"""Cached reflected rays: what they meet is looked up, and only the light has to be known."""

from __future__ import annotations

import numpy as np

from iris_addon.materials.lobes import LobeRays


def test_a_lamp_is_mirrored_with_its_pattern() -> None:
    """Two rays that meet a lamp of one face on two patches, and one that meets a wall."""
    ones = np.ones((1, 3), np.float32)
    target, face = np.array([[0, 1, 2]], np.int32), np.array([[0, 0, 1]], np.int32)
    rays = LobeRays(target=target, face=face, weight0=ones, weight1=2 * ones, schlick=0 * ones)
    radiance, emission = np.array([[9.0] * 3, [9.0] * 3, [0.5] * 3]), np.array([[4.0, 2.0, 1.0], [0.0] * 3])
    seen = radiance, np.zeros(3), emission, np.zeros(3)
    even, _ = rays.radiance(*seen)
    np.testing.assert_allclose(even, [[8.5, 4.5, 2.5]])
    first, second = rays.radiance(*seen, np.array([0.25, 1.0, 7.0]))
    np.testing.assert_allclose(first, [[5.5, 3.0, 1.75]])
    np.testing.assert_allclose(second, 2 * first)
