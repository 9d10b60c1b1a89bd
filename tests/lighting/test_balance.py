"""The light balance: lamps from the albedo they imply, in a room whose radiosity is solved exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from iris_addon.base.progress import Progress
from iris_addon.lighting.balance import (
    MAX_ALBEDO,
    ROBUST_LOG,
    ROOM_ALBEDO,
    Balance,
    DirectEvidence,
    Evidence,
    LightBalance,
    ShadedPatches,
    solve_balance,
)
from iris_addon.rays.tracer import Tracer
from iris_addon.transport.form_factors import emitter_form_factors
from iris_addon.transport.gather import gather
from tests.engine_room import Room, furnished_room, room_origins


@dataclass(frozen=True)
class Shading:
    """The input of the balance, one patch per face of the room, and the truth."""

    radiance: np.ndarray
    indirect: np.ndarray
    form_factors: np.ndarray
    region: np.ndarray
    weight: np.ndarray
    truth: np.ndarray
    bounded: np.ndarray | None = None

    @property
    def nothing_known(self) -> Evidence:
        n = len(self.truth)
        nan = np.full((n, 3), np.nan)
        return Evidence(np.zeros((n, 3)), nan, np.arange(n), nan)

    def solve(self, evidence: Evidence | None = None, start: np.ndarray | None = None) -> Balance:
        begin = np.ones_like(self.truth) if start is None else start
        patches = ShadedPatches(
            radiance=self.radiance,
            indirect=self.indirect,
            form_factors=self.form_factors,
            region=self.region,
            weight=self.weight,
            bounded=self.bounded,
        )
        return solve_balance(patches, evidence or self.nothing_known, begin)


def exact_shading(room: Room) -> Shading:
    """Radiosity to convergence under the very G and B that the balance gets: any error is the balance's own."""
    tracer, rng = Tracer(room.mesh), np.random.default_rng(0)
    origins = room_origins(room, tracer, 4, rng)
    rays, _ = gather(tracer, origins, 128, rng, Progress())
    lamps = room.lamps()
    factors = emitter_form_factors(tracer, origins, rays, lamps, 48, rng, Progress())[..., 0].astype(np.float64)
    truth = np.array([room.emission[room.regions[faces[0]]] for faces in lamps])
    albedo = room.albedo[room.regions]
    radiance = np.zeros_like(albedo)
    for _ in range(60):
        indirect = np.concatenate([radiance, np.zeros((1, 3))])[rays.face].mean(1)
        radiance = albedo * (indirect + factors @ truth)
    rows = np.flatnonzero((albedo.min(1) > 0) & (radiance.min(1) > 1e-3))
    return Shading(
        radiance=radiance[rows],
        indirect=indirect[rows],
        form_factors=factors[rows],
        region=room.regions[rows],
        weight=np.ones(len(rows)),
        truth=truth,
    )


@pytest.fixture(scope="module")
def shading() -> Shading:
    return exact_shading(furnished_room())


def one_lamp(shading: Shading) -> Shading:
    """The same room under its second lamp alone. Light is linear, but radiosity has to be solved again."""
    room = furnished_room()
    emission = room.emission.copy()
    emission[8] = 0
    albedo = room.albedo.copy()
    albedo[8] = 0.5
    return exact_shading(replace(room, emission=emission, albedo=albedo))


def test_two_lamps_come_back_exactly(shading: Shading) -> None:
    balance = shading.solve()
    assert balance.radiance == pytest.approx(shading.truth, rel=0.02)
    expected = furnished_room().albedo[balance.region_ids]
    assert balance.region_albedo == pytest.approx(expected, rel=0.02)


def test_one_lamp_comes_back_exactly(shading: Shading) -> None:
    alone = one_lamp(shading)
    assert alone.truth.shape == (1, 3)
    assert alone.solve().radiance == pytest.approx(alone.truth, rel=0.02)


@pytest.mark.parametrize("factor", [0.05, 30.0])
def test_solution_is_invariant_to_the_start(shading: Shading, factor: float) -> None:
    assert shading.solve(start=shading.truth * factor).radiance == pytest.approx(shading.truth, rel=0.03)


def test_without_interreflection_albedo_is_that_of_the_prior(shading: Shading) -> None:
    """Without interreflection photos determine only light times albedo; the prior on a room's albedo sets the level."""
    from_lamps = shading.form_factors @ shading.truth
    direct = shading.radiance * from_lamps / (shading.indirect + from_lamps)
    dark = replace(shading, radiance=direct, indirect=np.zeros_like(direct))
    for factor in (0.05, 30.0):
        balance = dark.solve(start=shading.truth * factor)
        share = np.bincount(np.searchsorted(balance.region_ids, shading.region), minlength=len(balance.region_ids))
        mean = np.exp((share / share.sum()) @ np.log(balance.region_albedo))
        assert mean.prod() ** (1 / 3) == pytest.approx(ROOM_ALBEDO, rel=0.05)
        ratio = balance.radiance / shading.truth
        assert ratio[0] == pytest.approx(ratio[1], rel=0.05)


def test_texture_and_outliers_hardly_change_the_lamps(shading: Shading) -> None:
    rng = np.random.default_rng(1)
    texture = np.exp(rng.normal(0, 0.15, (len(shading.region), 1)))
    wrong = rng.random(len(shading.region)) < 0.1
    texture[wrong] *= rng.uniform(2, 6, (int(wrong.sum()), 1))  # highlights, stickers
    noisy = replace(shading, radiance=shading.radiance * texture)
    assert noisy.solve().radiance == pytest.approx(shading.truth, rel=0.15)


def clipped_at(shading: Shading, level: float) -> Shading:
    """What photos show that clip from a radiance of ``level`` on."""
    clipped = shading.radiance > level
    return replace(shading, radiance=np.minimum(shading.radiance, level), bounded=clipped)


def test_what_clips_may_be_brighter(shading: Shading) -> None:
    """A quarter of all patches is brighter than its bound, up to several times."""
    shown = clipped_at(shading, float(np.quantile(shading.radiance, 0.75)))
    assert shown.bounded is not None and shown.bounded.mean() > 0.2
    assert shown.solve().radiance == pytest.approx(shading.truth, rel=0.03)
    measured = replace(shown, bounded=None).solve()
    assert np.abs(measured.radiance / shading.truth - 1).max() > 0.1  # as measurements the bounds mislead


def test_what_clips_is_no_darker(shading: Shading) -> None:
    """Without interreflection the level of light is the prior's, unless a surface clips that it leaves too dark."""
    from_lamps = shading.form_factors @ shading.truth
    direct = shading.radiance * from_lamps / (shading.indirect + from_lamps)
    dark = replace(shading, radiance=direct, indirect=np.zeros_like(direct), bounded=np.zeros(direct.shape, bool))
    before = dark.solve()
    usual = np.median(before.region_albedo)
    wall = int(np.bincount(shading.region).argmax())
    of_wall = before.region_albedo[list(before.region_ids).index(wall)]
    bright, bounded = direct.copy(), dark.bounded.copy()
    bright[shading.region == wall] *= 4 * usual / of_wall  # needs a reflectance of four times the usual one
    bounded[shading.region == wall] = True
    after = replace(dark, radiance=bright, bounded=bounded).solve()
    assert 4 * usual > 1.3  # or nothing is too bright
    least = 4 * usual / MAX_ALBEDO
    assert (after.radiance / before.radiance).min() > 0.8 * least


def posed(shading: Shading, region: np.ndarray, evidence: Evidence) -> LightBalance:
    """The loss over all patches, with regions labelled 0 to n - 1."""
    ids, label = np.unique(region, return_inverse=True)
    columns = (np.log(shading.radiance), shading.indirect, shading.form_factors)
    log_radiance, indirect, form_factors = (torch.from_numpy(column.T.copy()) for column in columns)
    return LightBalance(
        log_radiance=log_radiance,
        bounded=torch.zeros(log_radiance.shape, dtype=torch.bool),
        indirect=indirect,
        form_factors=form_factors,
        weight=torch.full((len(label),), 1 / len(label), dtype=torch.float64),
        region=torch.from_numpy(label),
        n_regions=len(ids),
        direct=DirectEvidence.of(evidence, form_factors.shape[0]),
        scale=ROBUST_LOG,
    )


def partly_clipped(problem: LightBalance) -> LightBalance:
    """The same with every fifth value no more than a bound."""
    every_fifth = torch.arange(problem.log_radiance.numel()).reshape(problem.log_radiance.shape) % 5 == 0
    return replace(problem, bounded=every_fifth)


def test_gradient_is_that_of_the_loss(shading: Shading) -> None:
    rng = np.random.default_rng(2)
    evidence = replace(shading.nothing_known, bound=shading.truth * 1.5, expected=shading.truth * 0.5)
    evidence.measured[0] = shading.truth[0] * 1.1
    problem = partly_clipped(posed(shading, shading.region, evidence))
    log_e = torch.from_numpy(np.log(shading.truth) + rng.normal(0, 0.4, (2, 3)))
    log_albedo = problem.implied_albedo(log_e) + torch.from_numpy(rng.normal(0, 0.3, (problem.n_regions, 3)))
    log_albedo[0] = np.log(MAX_ALBEDO) + 0.2  # the penalty on white is in force
    unknowns = torch.cat([log_e.reshape(-1), log_albedo.reshape(-1)]).requires_grad_()
    assert torch.autograd.gradcheck(problem.loss, (unknowns,))


def test_the_loss_is_equation_18(shading: Shading) -> None:
    """Written once more as loops over patches, regions and lamps."""
    evidence = replace(shading.nothing_known, bound=shading.truth * 1.5, expected=shading.truth * 0.5)
    evidence.measured[0] = shading.truth[0] * 1.1
    problem = partly_clipped(posed(shading, shading.region, evidence))
    log_e = np.log(shading.truth) + 0.1 * np.arange(6).reshape(2, 3)
    log_a = np.log(np.linspace(0.3, 1.2, 3 * problem.n_regions)).reshape(-1, 3)
    label = np.unique(shading.region, return_inverse=True)[1]
    share = np.bincount(label) / len(label)
    expected, n = 0.0, min(len(label), 500)
    for p in range(len(label)):
        incoming = shading.indirect[p] + shading.form_factors[p] @ np.exp(log_e)
        r = (np.log(shading.radiance[p]) - np.log(incoming) - log_a[label[p]]) / ROBUST_LOG
        r = np.where(problem.bounded[:, p].numpy(), np.maximum(r, 0), r)
        expected += np.log(1 + r**2).sum() / len(label)
    for k, albedo in enumerate(log_a):
        expected += 50 * share[k] * (np.maximum(albedo - np.log(0.95), 0) ** 2).sum()
    measured = ~problem.bounded.numpy().T
    for c in range(3):  # what clips says nothing of the room's albedo
        expected += ((log_a[label[measured[:, c]], c].mean() - np.log(0.45)) / 0.5) ** 2 / n
    for i, e in enumerate(log_e):
        q = (np.maximum(np.log(1.5 * shading.truth[i]) - e, 0) / 0.02) ** 2 + ((e - e.mean()) / 0.35) ** 2
        q += ((e - np.log(0.5 * shading.truth[i])) / 4) ** 2
        q += ((e - np.log(1.1 * shading.truth[i])) / 0.03) ** 2 if i == 0 else 0.0
        expected += q.sum() / n
    unknowns = torch.from_numpy(np.concatenate([log_e.ravel(), log_a.ravel()]))
    assert float(problem.loss(unknowns)) == pytest.approx(expected, rel=1e-9)


def test_unknowns_are_scaled_to_equal_curvature(shading: Shading) -> None:
    """At the solution the loss has the same curvature in all of them, from a large wall to the smallest region."""
    rng = np.random.default_rng(8)
    region = shading.region + np.where(rng.random(len(shading.region)) < 0.03, 10, 0)  # a small piece off every wall
    problem = posed(shading, region, shading.nothing_known)
    x = problem.joined(torch.from_numpy(np.log(shading.truth)))
    unit = problem.units(x)
    curvature = torch.autograd.functional.hessian(problem.loss, x).diagonal() * unit**2
    # The curvature of log(1 + r^2) is 2; the rest is what is expected of lamps and rooms.
    assert curvature.numpy() == pytest.approx(2 / ROBUST_LOG**2, rel=0.3)
    assert unit.max() > 10 * unit.min()


def test_clipping_is_a_lower_bound(shading: Shading) -> None:
    below, above = shading.truth * 0.5, shading.truth * 1.4
    assert shading.solve(replace(shading.nothing_known, bound=below)).radiance == pytest.approx(shading.truth, rel=0.03)
    forced = shading.solve(replace(shading.nothing_known, bound=above)).radiance
    assert (forced > 0.9 * above).all()


def test_a_clipped_speck_without_influence_stays_near_its_expectation(shading: Shading) -> None:
    """Other errors of the room would make it a hundred times as bright for a tiny gain in fit."""
    rng = np.random.default_rng(9)
    speck = 1e-5 * rng.random((len(shading.region), 1))
    error = np.exp(rng.normal(0, 0.05, (len(shading.region), 1)) + 500 * speck)
    beside = replace(
        shading,
        form_factors=np.concatenate([shading.form_factors, speck], 1),
        radiance=shading.radiance * error,
        truth=np.concatenate([shading.truth, np.zeros((1, 3))]),
    )
    clipped = replace(beside.nothing_known, bound=np.array([[0.0] * 3, [0.0] * 3, [1.0] * 3]))
    start = np.concatenate([shading.truth, np.full((1, 3), 2.0)])
    told = replace(clipped, expected=np.array([[np.nan] * 3, [np.nan] * 3, [2.0] * 3]))
    assert beside.solve(told, start).radiance[2] == pytest.approx(2.0, abs=2.0)
    assert beside.solve(clipped, start).radiance[2].max() > 20


def test_a_measured_yellow_speck_does_not_change_the_lamps(shading: Shading) -> None:
    """A lemon in the sun, taken for a lamp: what is known of it is far sharper than what the room says of the
    lamps, and unlike any tint. Steps in units of the room alone ended at lamps a fifth too dim."""
    speck = 1e-5 * np.random.default_rng(9).random((len(shading.region), 1))
    beside = replace(
        shading,
        form_factors=np.concatenate([shading.form_factors, speck], 1),
        truth=np.concatenate([shading.truth, np.zeros((1, 3))]),
    )
    lemon = np.array([2.1, 2.1, 0.15])
    evidence = replace(beside.nothing_known, measured=np.array([[np.nan] * 3, [np.nan] * 3, lemon]))
    found = beside.solve(evidence, np.concatenate([np.ones((2, 3)), lemon[None]])).radiance
    assert found[:2] == pytest.approx(shading.truth, rel=0.01)
    assert found[2] == pytest.approx(lemon, rel=0.1)


def test_precision_is_half_the_curvature_of_the_penalty() -> None:
    """For a bound, a measurement, an expectation, and tint alone."""
    bound, measured, expected = (
        torch.full((4, 3), value, dtype=torch.float64) for value in (np.log(1e-6), np.nan, np.nan)
    )
    bound[0], measured[1], expected[2] = 0.5, 0.3, -0.2
    direct, log_e = DirectEvidence(bound, measured, expected), torch.zeros((4, 3), dtype=torch.float64)
    curvature = torch.autograd.functional.hessian(direct.penalty, log_e).reshape(12, 12).diagonal()
    assert direct.precision(log_e).reshape(-1).numpy() == pytest.approx(curvature.numpy() / 2)


def test_a_measurement_attracts_the_radiance(shading: Shading) -> None:
    measured = np.full_like(shading.truth, np.nan)
    measured[1] = shading.truth[1] * 1.2
    balance = shading.solve(replace(shading.nothing_known, measured=measured))
    assert (balance.radiance[1] > shading.truth[1] * 1.05).all()
    assert balance.radiance[0] == pytest.approx(shading.truth[0], rel=0.1)


def test_tied_fixtures_share_one_radiance(shading: Shading) -> None:
    tied = replace(shading.nothing_known, tie=np.zeros(2, np.int64))
    radiance = shading.solve(tied).radiance
    assert (radiance[0] == radiance[1]).all()
    low, high = np.sort(shading.truth, axis=0)
    assert (radiance[0] > 0.9 * low).all() and (radiance[0] < 1.1 * high).all()


def test_distant_patches_of_a_region_determine_the_scale(shading: Shading) -> None:
    """Cut every wall into tiles of even light with an albedo of their own: only neighbours are left to compare."""
    order = np.lexsort((shading.radiance[:, 1], shading.region))
    tiles = np.empty_like(shading.region)
    tiles[order] = np.arange(len(order)) // 13
    square = np.zeros(2)
    for seed in range(4):
        texture = np.exp(np.random.default_rng(seed).normal(0, 0.2, (len(shading.region), 1)))
        noisy = replace(shading, radiance=shading.radiance * texture)
        for k, region in enumerate((shading.region, tiles)):
            square[k] += (np.log(replace(noisy, region=region).solve().radiance / shading.truth) ** 2).mean()
    assert square[1] > 3 * square[0]


def test_a_lamp_that_lights_nothing_has_the_largest_uncertainty() -> None:
    room = furnished_room()
    emission = room.emission.copy()
    emission[9] *= 1e-3
    shading = exact_shading(replace(room, emission=emission))
    balance = shading.solve(start=shading.truth * 2)
    assert balance.log_std[1] > 10 * balance.log_std[0]


def test_a_lamp_far_from_its_start_does_not_overflow(shading: Shading) -> None:
    stronger = replace(shading, form_factors=shading.form_factors * [1.0, 1e-3])
    assert stronger.solve().radiance == pytest.approx(shading.truth * [[1], [1000]], rel=0.1)


def test_solution_is_invariant_to_patches_of_no_weight(shading: Shading) -> None:
    rng = np.random.default_rng(4)
    spoiled = rng.random(len(shading.region)) < 0.3
    radiance = np.where(spoiled[:, None], rng.random((len(spoiled), 3)) * 5, shading.radiance)
    balance = replace(shading, radiance=radiance, weight=np.where(spoiled, 0.0, 1.0)).solve()
    assert balance.radiance == pytest.approx(shading.truth, rel=0.02)


def test_errors_of_irradiance_make_lamps_dim_unless_weighted_down(shading: Shading) -> None:
    """Errors of the regressors, as where the normals of a mesh are noise."""
    rng = np.random.default_rng(6)
    shaken = rng.random(len(shading.region)) < 0.6
    off = np.exp(np.where(shaken, rng.normal(0, 0.5, shaken.shape), 0.0))[:, None]
    noisy = replace(shading, form_factors=shading.form_factors * off)
    assert (noisy.solve().radiance < 0.9 * shading.truth).all()
    knowing = replace(noisy, weight=1 / (1 + (np.where(shaken, 0.5, 0.0) / ROBUST_LOG) ** 2))
    assert knowing.solve().radiance == pytest.approx(shading.truth, rel=0.05)


def test_held_out_loss_rises_with_model_error(shading: Shading) -> None:
    rng = np.random.default_rng(5)
    texture = np.exp(rng.normal(0, 0.3, (len(shading.region), 1)))
    assert shading.solve().held_out < 0.01
    assert replace(shading, radiance=shading.radiance * texture).solve().held_out > 0.3
