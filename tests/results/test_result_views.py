"""Views of a capture follow what the solve found out about its cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.model.capture import Camera, View
from tests.box_room import look_at
from tests.result_room import room


@pytest.mark.parametrize(("given", "scale"), [(0.5, 0.5), (None, 1.0), ("much", 1.0), (float("nan"), 1.0), (-2.0, 1.0)])
def test_views_are_in_the_unit_that_the_capture_was_solved_in(given: object, scale: float) -> None:
    result = room()
    pose = look_at(np.array([1.0, 2.0, 3.0]), np.zeros(3))
    view = View("a", Camera(width=4, height=3, fx=3.0, fy=3.0, cx=2.0, cy=1.5, c2w=pose), None)
    (before,) = result.as_taken([view])
    (after,) = replace(result, report={**result.report, "metres_per_unit": given}).as_taken([view])
    np.testing.assert_allclose(after.camera.position, scale * before.camera.position)
    np.testing.assert_allclose(after.camera.c2w[:3, :3], before.camera.c2w[:3, :3])
