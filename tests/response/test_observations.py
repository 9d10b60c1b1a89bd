"""Observations: means over pixels per patch and view."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model.response import SATURATED
from tests.engine_room import observe_off_edges


def test_observations_are_means_per_patch_and_view() -> None:
    rng = np.random.default_rng(9)
    patch, view = rng.integers(0, 20, 3000).astype(np.int32), rng.integers(0, 5, 3000).astype(np.int16)
    z = rng.random((3000, 3)).astype(np.float32)
    z[rng.random(3000) < 0.2] = 1.0
    o = observe_off_edges(patch, view, z, rng)
    assert (o.patch[o.sample_to_observation] == patch).all() and (o.view[o.sample_to_observation] == view).all()
    assert (patch[o.sample] == o.patch).all() and (view[o.sample] == o.view).all()
    rows = (patch == 7) & (view == 3)
    at = np.flatnonzero((o.patch == 7) & (o.view == 3))[0]
    assert o.count[at] == rows.sum()
    assert o.z[at] == pytest.approx(z[rows].mean(0), abs=1e-5)
    assert o.spread[at] == pytest.approx(z[rows].std(0), abs=1e-4)
    assert o.saturated[at] == pytest.approx((z[rows] >= SATURATED).mean(0))
