"""The light balance of two light states: what one state leaves open, the albedo that the other determines tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.lighting.balance import ITERATIONS, ROBUST_LOG, Evidence, ShadedPatches
from iris_addon.lighting.joint_balance import BalanceInput, solve_joined

ALBEDO = np.array([[0.7, 0.6, 0.5], [0.2, 0.3, 0.4], [0.5, 0.5, 0.45]])
"""Of three regions."""
PER_REGION = 120
FIRST, SECOND = np.array([[9.0, 8.0, 6.0]]), np.array([[2.0, 3.0, 4.0]])
"""Radiance of the lamp that is on in each state."""


def state(lamp: np.ndarray, seed: int, measured: bool) -> BalanceInput:
    """Patches of all regions under one lamp and a little light from elsewhere."""
    rng = np.random.default_rng(seed)
    region = np.repeat(np.arange(3), PER_REGION)
    factors = rng.uniform(0.002, 0.2, (len(region), 1))
    indirect = rng.uniform(0.001, 0.004, (len(region), 1)) * lamp
    patches = ShadedPatches(
        radiance=ALBEDO[region] * (indirect + factors @ lamp),
        indirect=indirect,
        form_factors=factors.astype(np.float32),
        region=region,
        weight=np.ones(len(region)),
    )
    nothing = np.full((1, 3), np.nan)
    shown = lamp if measured else nothing
    evidence = Evidence(bound=np.zeros((1, 3)), measured=shown, tie=np.zeros(1, np.int64), expected=nothing)
    return BalanceInput(patches, evidence, np.ones((1, 3)))


def solved(*states: BalanceInput) -> list[np.ndarray]:
    return [balance.radiance for balance in solve_joined(list(states), ROBUST_LOG, False, ITERATIONS)]


def test_a_lamp_that_no_photo_shows_is_told_by_the_albedo_of_another_state() -> None:
    seen, unseen = state(FIRST, 1, measured=True), state(SECOND, 2, measured=False)
    together = solved(seen, unseen)
    assert together[0] == pytest.approx(FIRST, rel=0.05)
    assert together[1] == pytest.approx(SECOND, rel=0.05)


def test_the_states_share_one_albedo_per_region() -> None:
    first, second = solve_joined(
        [state(FIRST, 1, measured=True), state(SECOND, 2, measured=False)], ROBUST_LOG, False, ITERATIONS
    )
    assert np.array_equal(first.region_albedo, second.region_albedo)
    assert first.region_albedo == pytest.approx(ALBEDO, rel=0.05)


def test_a_lamp_that_is_on_in_one_state_alone_lights_no_patch_of_the_other() -> None:
    alone = solved(state(FIRST, 1, measured=True))[0]
    beside = solved(state(FIRST, 1, measured=True), state(1e3 * SECOND, 2, measured=True))[0]
    assert beside == pytest.approx(alone, rel=0.02)


def test_a_lamp_of_one_number_has_one_radiance_in_all_states() -> None:
    """Each state alone has the lamp a little wrong, on either side of what both together tell."""
    shown, unshown = state(FIRST, 1, measured=True), state(FIRST, 2, measured=False)
    numbers = np.array([4])
    both = solved(replace(shown, lamps=numbers), replace(unshown, lamps=numbers))
    assert np.array_equal(both[0], both[1])
    assert both[0] == pytest.approx(FIRST, rel=0.05)
    apart = solved(replace(shown, lamps=numbers), replace(unshown, lamps=numbers + 1))
    assert not np.array_equal(apart[0], apart[1])


def test_the_held_out_loss_of_a_state_is_that_of_its_own_patches() -> None:
    right, wrong = state(FIRST, 1, measured=True), state(SECOND, 2, measured=True)
    rng = np.random.default_rng(3)
    noise = np.exp(rng.normal(0, 0.3, wrong.patches.radiance.shape))
    noisy = ShadedPatches(
        radiance=wrong.patches.radiance * noise,
        indirect=wrong.patches.indirect,
        form_factors=wrong.patches.form_factors,
        region=wrong.patches.region,
        weight=wrong.patches.weight,
    )
    first, second = solve_joined(
        [right, BalanceInput(noisy, wrong.evidence, wrong.start)], ROBUST_LOG, False, ITERATIONS
    )
    assert first.held_out < 0.05 < second.held_out
    assert first.losses.observation.max() < 3 * PER_REGION
    assert second.losses.observation.max() < 3 * PER_REGION
