"""Rays aimed at bright patches: the light that gather rays bring in the mean, with a fraction of their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.rays.tracer import Tracer
from iris_addon.transport.aimed_rays import aim_at_bright
from iris_addon.transport.form_factors import emitter_form_factors
from iris_addon.transport.transport import Transport
from tests.engine_room import LAMP_REGIONS, Room, cameras, furnished_room, patched

PLATE = LAMP_REGIONS[1]
BRIGHT = 300.0
"""Radiance of a plate of 30 by 40 cm that hangs in the room; everything else has one."""


@pytest.fixture(scope="module")
def traced() -> tuple[Room, Tracer, Transport]:
    room = furnished_room()
    seen = patched(room, cameras(), 3000, 64, seed=9)
    return room, seen.tracer, seen.transport


def gathered_and_aimed(room: Room, tracer: Tracer, transport: Transport) -> tuple[np.ndarray, np.ndarray]:
    """(P,) light at the seen patches, by gather rays alone and with aimed ones."""
    cast = np.ones((transport.n_patches, 3))
    cast[transport.region == PLATE] = BRIGHT
    none, unknown = np.zeros(len(tracer.areas), bool), np.ones(3)
    gathered = transport.gather_radiance(cast, unknown, none)
    aimed = aim_at_bright(tracer, transport, room.regions, cast, gathered, none, np.random.default_rng(1))
    assert aimed is not None
    better = gathered + aimed.gather_radiance(cast, unknown, none)
    assert better[transport.n_seen :] == pytest.approx(gathered[transport.n_seen :])
    return gathered[: transport.n_seen, 0], better[: transport.n_seen, 0]


def test_aimed_rays_see_what_shadow_rays_to_a_lamp_see(traced: tuple[Room, Tracer, Transport]) -> None:
    room, tracer, transport = traced
    plate = np.flatnonzero(room.regions == PLATE)
    args = tracer, transport.origins, transport.rays, [plate], 1024, np.random.default_rng(2), Progress()
    expected = 1 + (BRIGHT - 1) * emitter_form_factors(*args)[:, 0, 0]
    gathered, aimed = gathered_and_aimed(*traced)
    assert aimed.mean() == pytest.approx(expected.mean(), rel=0.01)
    error, before = (np.abs(light / expected - 1) for light in (aimed, gathered))
    assert error.mean() < 0.08 < before.mean() / 4
    assert np.quantile(error, 0.99) < 0.5 * np.quantile(before, 0.99)


def test_lobes_at_both_ends_are_those_of_gather_rays(traced: tuple[Room, Tracer, Transport]) -> None:
    room, tracer, transport = traced
    grazing = replace(transport, kappa=np.full(transport.n_patches, 0.8))
    matte, rough = gathered_and_aimed(*traced), gathered_and_aimed(room, tracer, grazing)
    assert rough[1].mean() / matte[1].mean() > 1.05
    assert rough[1].mean() == pytest.approx(rough[0].mean(), rel=0.02)


def test_no_ray_is_aimed_at_lamps(traced: tuple[Room, Tracer, Transport]) -> None:
    room, tracer, transport = traced
    cast = np.where((transport.region == PLATE)[:, None], BRIGHT, np.ones((1, 3)))
    lamp, rng = room.regions == PLATE, np.random.default_rng(3)
    assert aim_at_bright(tracer, transport, room.regions, cast, np.ones_like(cast), lamp, rng) is None


def test_no_ray_is_aimed_without_bright_patches(traced: tuple[Room, Tracer, Transport]) -> None:
    room, tracer, transport = traced
    cast, none = np.random.default_rng(4).uniform(0.2, 2, (transport.n_patches, 3)), np.zeros(len(tracer.areas), bool)
    before = tracer.rays_traced
    assert aim_at_bright(tracer, transport, room.regions, cast, cast, none, np.random.default_rng(5)) is None
    assert tracer.rays_traced == before


def test_a_speck_that_few_rays_meet_is_aimed_at_where_each_would_make_a_spot(
    traced: tuple[Room, Tracer, Transport],
) -> None:
    """A patch that a few patches in a hundred meet by one ray sends little, and doubles the light of each of these."""
    room, tracer, transport = traced
    n_rays, n = transport.target.shape[1], transport.n_seen
    met = np.zeros(transport.n_patches)
    for row in transport.target[:n]:
        met[np.unique(row[row >= 0])] += 1
    speck = np.flatnonzero(met <= 0.015 * n)[np.argmax(met[met <= 0.015 * n])]
    assert met[speck] > 0.004 * n
    none = np.zeros(len(tracer.areas), bool)

    def aimed(radiance: float):
        cast, light = np.ones((transport.n_patches, 3)), np.ones((transport.n_patches, 3))
        cast[speck] = radiance
        return aim_at_bright(tracer, transport, room.regions, cast, light, none, np.random.default_rng(1))

    assert aimed(1.2 * n_rays) is not None
    assert aimed(0.25 * n_rays) is None, "no spot to be seen, and hardly any light"
