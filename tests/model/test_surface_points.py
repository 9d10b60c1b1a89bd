"""Points spread over triangles: in proportion to area, and evenly within each."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model.surface_points import even_points, interpolated


def test_triangles_get_points_by_their_area() -> None:
    face, weights = even_points(np.array([1.0, 0.0, 5.0, 2.0]), 800)
    assert np.bincount(face, minlength=4).tolist() == pytest.approx([100, 0, 500, 200], abs=1)
    assert weights.min() >= 0 and weights.sum(1) == pytest.approx(1)


def test_points_are_even_within_a_triangle() -> None:
    """Their mean is five times closer to the centre than that of as many random points would be (0.24 / sqrt(n))."""
    _, weights = even_points(np.ones(1), 1000)
    assert weights.mean(0) == pytest.approx(1 / 3, abs=1.5e-3)
    second = weights.T @ weights / len(weights)
    assert second == pytest.approx(np.full((3, 3), 1 / 12) + np.eye(3) / 12, abs=2e-3)


def test_values_are_those_of_the_corners_by_their_weights() -> None:
    corners = np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 4.0]]])
    assert interpolated(corners, np.array([[0.5, 0.25, 0.25]])) == pytest.approx(np.array([[0.5, 1.0]]))
