"""Observations: means over pixels per patch and view."""

from __future__ import annotations

import numpy as np
import pytest

from iris_addon.model.light_states import LightStates
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


def test_photos_of_different_light_states_share_no_patch() -> None:
    rng = np.random.default_rng(4)
    patch, view = rng.integers(0, 20, 900).astype(np.int32), rng.integers(0, 6, 900).astype(np.int16)
    o = observe_off_edges(patch, view, rng.random((900, 3)).astype(np.float32), rng)
    states = LightStates(("day", "night"), np.array([0, 1, 1, 0, 1, 0]))
    apart = o.apart(states)
    for shared in np.unique(apart.patch):
        assert len(np.unique(states.index[apart.view[apart.patch == shared]])) == 1
    assert (apart.patch // 2 == o.patch).all()
    assert o.apart(LightStates(("",), np.zeros(6, np.int64))) is o


def test_the_observations_of_some_photos_are_those_of_their_pixels_alone() -> None:
    rng = np.random.default_rng(4)
    patch, view = rng.integers(0, 20, 900).astype(np.int32), np.sort(rng.integers(0, 6, 900)).astype(np.int16)
    z = rng.random((900, 3)).astype(np.float32)
    some = np.array([True, False, True, True, False, False])
    kept = some[view]
    part = observe_off_edges(patch, view, z, rng).of_photos(some)
    alone = observe_off_edges(patch[kept], view[kept], z[kept], rng)
    for name in ("patch", "view", "count", "z", "spread", "sample_to_observation"):
        assert np.array_equal(getattr(part, name), getattr(alone, name)), name
    assert (patch[kept][part.sample] == part.patch).all()
    assert (view[kept][part.sample] == part.view).all()
