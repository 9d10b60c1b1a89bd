"""The solution of the lighting problem: its warnings and its checkpoint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.lighting.problem import Lights


def lights(n_lamps: int, outside: float = 0.0) -> Lights:
    """Lamps of one face each, and constant light from outside."""
    return Lights(
        emitters=[np.array([k]) for k in range(n_lamps)],
        radiance=np.ones((n_lamps, 3)),
        hidden_radiance=np.full((1, 3), outside),
        log_std=np.zeros(n_lamps),
        form_factors=np.zeros((4, n_lamps, 2), np.float32),
        mask=np.arange(100) < n_lamps,
        irradiance=np.ones((4, 3)),
        patch_radiance=np.ones((4, 3)),
    )


def test_a_room_without_light_is_reported() -> None:
    assert "no light" in lights(0).warnings[0]
    assert lights(0, outside=1.0).warnings == () and lights(1).warnings == ()


@pytest.mark.parametrize("share", [None, np.array([0.5, 1.5, 1.0, 1.0], np.float32)])
def test_lights_survive_a_checkpoint(share: np.ndarray | None) -> None:
    pattern = np.array([] if share is None else [1], np.int64)
    before = replace(lights(3, outside=2.0), patterned=pattern, lamp_share=share)
    after = Lights.from_arrays(before.arrays())
    assert (after.lamp_share is None) == (share is None) and after.arrays().keys() == before.arrays().keys()
    assert [faces.tolist() for faces in after.emitters] == [[0], [1], [2]]
    for name, value in before.arrays().items():
        np.testing.assert_array_equal(after.arrays()[name], value)
