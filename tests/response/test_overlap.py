"""The camera response: its family, and its recovery from overlap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from iris_addon.base.images import read_image
from iris_addon.base.minimise import linearised
from iris_addon.capture.exposures import exif_settings
from iris_addon.decide import Decisions
from iris_addon.model import response as curve
from iris_addon.model.response import N_SAMPLES, Response
from iris_addon.response import family
from iris_addon.response.clipping import photo_noise
from iris_addon.response.observations import Observations
from iris_addon.response.overlap import fit_overlap
from iris_addon.response.overlap_problem import OverlapProblem, cauchy_root, geman_mcclure_root
from iris_addon.response.photometry import Photometry
from tests.engine_room import observe_off_edges
from tests.response.photographed_patches import EXPOSURES, by_phone, observations_of

X = np.linspace(0, 1, N_SAMPLES)


def film(slope: float = 1.5) -> np.ndarray:
    """A film-like S on a log-exposure axis, lifted to 0 and 1."""
    s = 1 / (1 + (0.18 / np.maximum(X, 1e-9)) ** slope)
    return s / s[-1]


def srgb() -> np.ndarray:
    s = np.where(X <= 0.0031308, 12.92 * X, 1.055 * np.maximum(X, 1e-9) ** (1 / 2.4) - 0.055)
    return s / s[-1]  # rounding must not keep white from saturating


CURVES = {
    "gamma 2.2": X ** (1 / 2.2),
    "gamma 1.6": X ** (1 / 1.6),
    "gamma 2.8": X ** (1 / 2.8),
    "sRGB": srgb(),
    "film": film(1.2),
    "steep film": film(1.5),
}


def response_of(samples: np.ndarray) -> Response:
    return Response(np.tile(samples, (3, 1)), "file")


def doubled(o: Observations) -> Observations:
    """Overlap wants two pixels behind an observation."""
    return replace(o, count=o.count * 4)


def crf_l2(found: Response, truth: np.ndarray) -> float:
    """Frobenius norm of the 3 x 1024 difference, the published measure."""
    return float(np.linalg.norm(found.samples - truth))


# The family ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_curves_of_the_family_rise_from_zero_to_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    knots = family.PRIOR_MEAN + torch.from_numpy(rng.normal(0, 0.4, (3, 1)) + rng.normal(0, 0.15, (3, family.N_KNOTS)))
    response = family.to_response(knots)
    assert response.samples[:, 0] == pytest.approx(0)
    assert response.samples[:, -1] == pytest.approx(1)
    assert (np.diff(response.samples, axis=1) >= 0).all()


def test_the_family_contains_gamma() -> None:
    knots = torch.full((1, family.N_KNOTS), np.log(1 / 2.2), dtype=torch.float64)
    assert family.Family(X).evaluate(knots)[0, 1:].numpy() == pytest.approx(X[1:] ** (1 / 2.2), abs=1e-6)
    assert family.downhill(knots).max() == 0


def test_downhill_is_positive_for_a_falling_curve() -> None:
    rising = torch.linspace(np.log(0.1), np.log(4.0), family.N_KNOTS, dtype=torch.float64)[
        None
    ]  # x^0.1 at the left, x^4 at the right
    assert family.downhill(rising).max() > 1e-3


@pytest.mark.parametrize("name", CURVES)
def test_apply_and_invert_undo_each_other(name: str) -> None:
    response = response_of(CURVES[name])
    x = np.random.default_rng(0).random((500, 3))
    assert response.invert(response.apply(x)) == pytest.approx(x, abs=2e-3)
    assert response.apply(np.full((1, 3), 7.0)) == pytest.approx(1.0)
    slope = (response.apply(x + 1e-3) - response.apply(x - 1e-3)) / 2e-3
    inside = (x > 0.05) & (x < 0.99)
    assert response.slope(x)[inside] == pytest.approx(slope[inside], rel=0.05)


# Recovery ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CURVES)
def test_known_exposures_give_the_curve(name: str) -> None:
    rng = np.random.default_rng(1)
    truth = response_of(CURVES[name])
    observations, _ = observations_of(truth, EXPOSURES, rng)
    fit = fit_overlap(doubled(observations), EXPOSURES, len(EXPOSURES), rng)
    assert crf_l2(fit.response, truth.samples) < 0.3
    assert not fit.per_channel
    assert fit.exposures == pytest.approx(np.repeat(EXPOSURES[:, None], 3, 1))


@pytest.mark.parametrize(("name", "limit"), [("gamma 2.2", 1.3), ("sRGB", 1.3), ("film", 2.0)])
def test_a_tenth_of_outliers_does_little(name: str, limit: float) -> None:
    rng = np.random.default_rng(2)
    truth = response_of(CURVES[name])
    observations, _ = observations_of(truth, EXPOSURES, rng, outliers=0.1)
    fit = fit_overlap(doubled(observations), EXPOSURES, len(EXPOSURES), rng)
    assert crf_l2(fit.response, truth.samples) < limit


def test_three_curves_are_accepted_where_there_are_three() -> None:
    rng = np.random.default_rng(3)
    truth = Response(np.stack([X ** (1 / 1.6), X ** (1 / 2.2), X ** (1 / 2.8)]), "file")
    observations, _ = observations_of(truth, EXPOSURES, rng)
    fit = fit_overlap(doubled(observations), EXPOSURES, len(EXPOSURES), rng)
    assert fit.per_channel
    assert crf_l2(fit.response, truth.samples) < 0.8


@pytest.mark.parametrize("name", ["gamma 2.2", "film"])
def test_highlights_do_not_move_the_radiance_that_clips(name: str) -> None:
    """A polished room: two fifths of all views of patches mirror something, and clip up to six times earlier."""
    rng = np.random.default_rng(9)
    truth = response_of(CURVES[name])
    observations, radiance = observations_of(truth, EXPOSURES, rng, n=600)
    shown = radiance[observations.patch] * EXPOSURES[observations.view][:, None]
    mirrored = rng.random(len(shown)) < 0.4
    shown[mirrored] *= 6 ** rng.random((int(mirrored.sum()), 1))
    z = np.floor(255 * truth.apply(np.clip(shown, 0, 1))) / 255
    saturated = (z >= 254.5 / 255).astype(np.float32)
    observations = replace(doubled(observations), z=z.astype(np.float32), saturated=saturated)
    fit = fit_overlap(observations, EXPOSURES, len(EXPOSURES), rng)
    assert crf_l2(fit.response, truth.samples) < 0.25


@pytest.mark.parametrize(("noise", "limit"), [(0.0, 0.1), (0.02, 0.6)], ids=["rendered", "by phone"])
def test_noise_below_clipping_does_not_move_the_radiance_that_clips(noise: float, limit: float) -> None:
    """Noise and JPEG take pixels off 255, so that what clips passes for a value: the error was 2.2 by phone."""
    rng = np.random.default_rng(1)
    truth, exposures = response_of(srgb()), 2.0 ** np.random.default_rng(2).uniform(-2, 2.2, 12)
    observations = by_phone(truth, exposures, rng, noise)
    assert (photo_noise(observations) > 0) == (noise > 0)
    one_curve = Decisions({"channel_curves": False, "corrected_exposures": False})
    fit = fit_overlap(observations, exposures, len(exposures), rng, decisions=one_curve)
    assert crf_l2(fit.response, truth.samples) < limit


@pytest.mark.parametrize("drift", ["exposure", "white balance"])
def test_wrongly_recorded_exposures_are_corrected(drift: str) -> None:
    """Two thirds of a stop of error; a third in each channel of its own where white balance drifts."""
    rng = np.random.default_rng(6)
    truth = response_of(CURVES["sRGB"])
    error = (
        rng.normal(0, 0.66, (len(EXPOSURES), 1)) if drift == "exposure" else rng.normal(0, 0.33, (len(EXPOSURES), 3))
    )
    taken = EXPOSURES[:, None] * 2.0 ** np.broadcast_to(error, (len(EXPOSURES), 3))
    observations, _ = observations_of(truth, taken, rng)
    fit = fit_overlap(doubled(observations), EXPOSURES, len(EXPOSURES), rng)
    # Twelve wrong records still say what the exponent is, to a fifth or so; overlap says the rest.
    found, true = np.log2(fit.exposures), np.log2(taken)
    for channel in range(3):
        exponent, offset = np.polyfit(true[:, channel], found[:, channel], 1)
        assert np.abs(found[:, channel] - (exponent * true[:, channel] + offset)).max() < 0.15
        assert exponent == pytest.approx(1.0, abs=0.3)


def test_exponent_error_is_that_of_the_regression_on_wrong_records() -> None:
    rng = np.random.default_rng(6)
    stops, records_off, draws = np.log2(EXPOSURES), 0.6, 4000
    records = stops + rng.normal(0, records_off, (draws, len(stops)))
    slope = (records - records.mean(1, keepdims=True)) @ (stops - stops.mean()) / np.sum((stops - stops.mean()) ** 2)
    taken = np.repeat(EXPOSURES[:, None], 3, 1)
    measured = Photometry(
        response=curve.gamma(),
        exposures=taken,
        held_out=0.0,
        per_channel=False,
        known_exposures=True,
        exposure_error=records_off,
    )
    assert measured.exponent_error == 0, "a curve that is given has its exponent"
    fitted = replace(measured, response=replace(measured.response, family=family.FITTED))
    assert fitted.exponent_error == pytest.approx(slope.std(), rel=0.05)
    assert fitted.exponent_unconstrained and not replace(fitted, exposure_error=0.0).exponent_unconstrained
    assert replace(fitted, known_exposures=False).exponent_error == np.inf
    alike = replace(fitted, exposures=np.ones_like(taken))
    assert alike.exponent_unconstrained and not replace(alike, exposure_error=0.0).exponent_unconstrained


@pytest.mark.parametrize("name", ["gamma 2.2", "film"])
def test_unknown_exposures_come_back_up_to_an_exponent(name: str) -> None:
    rng = np.random.default_rng(4)
    truth = response_of(CURVES[name])
    observations, _ = observations_of(truth, EXPOSURES, rng)
    fit = fit_overlap(doubled(observations), None, len(EXPOSURES), rng)
    stops, found = np.log2(EXPOSURES), np.log2(fit.exposures).mean(1)
    exponent, offset = np.polyfit(stops, found, 1)
    assert np.abs(found - (exponent * stops + offset)).max() < 0.12
    assert 0.5 < exponent < 2
    # The curve is that of the photos under the same exponent: f(x) = true f(x^(1/g)).
    equivalent = np.interp(X ** (1 / exponent), X, truth.samples[0])
    assert np.abs(fit.response.samples - equivalent).max() < 0.06


def test_a_bracket_of_thirteen_stops_through_a_soft_shoulder() -> None:
    """In the short photos nearly all is black, in the long ones nearly all is on the shoulder."""
    rng = np.random.default_rng(14)
    stops = np.array([3.7, 3.3, 2.0, 1.7, 0.0, -0.3, -1.7, -2.0, -4.0, -5.9, -6.3, -8.3, -8.6, -10.0])
    shoulder = 1 - np.exp(-18 * X**0.7)
    observations, _ = observations_of(response_of(shoulder / shoulder[-1]), 2.0 ** (stops + 1), rng, 1500, 0.02)
    found = np.log2(fit_overlap(doubled(observations), None, len(stops), rng).exposures).mean(1)
    exponent, offset = np.polyfit(found, stops, 1)
    assert np.sqrt(np.mean((exponent * found + offset - stops) ** 2)) < 0.15
    assert exponent == pytest.approx(1.0, abs=0.4), "measured responses are that much alike in the midtones"


def test_the_times_of_a_real_bracket_come_back(shared: Path) -> None:
    """A desk in 13 exposures over 13.7 stops, the last of which is nearly black."""
    photos = sorted((shared / "brackets" / "desk").glob("*.jpg"))
    if not photos:
        pytest.skip("shared/brackets/desk is not there")
    z = np.stack([read_image(photo)[::4, ::4] for photo in photos]) / 255
    n = z[0, :, :, 0].size
    patch, view = np.tile(np.arange(n), len(photos)), np.repeat(np.arange(len(photos)), n)
    desk = doubled(observe_off_edges(patch, view, z.reshape(-1, 3), np.random.default_rng(0)))
    seconds = np.log2([exif_settings(photo)["seconds"] for photo in photos])
    found = np.log2(fit_overlap(desk, None, len(photos), np.random.default_rng(1)).exposures).mean(1)
    seconds, found = seconds - seconds.mean(), found - found.mean()
    exponent = (found @ seconds) / (found @ found)
    assert np.sqrt(np.mean((exponent * found - seconds) ** 2)) < 0.15
    assert np.sqrt(np.mean((found - seconds) ** 2)) < 0.5


@pytest.mark.parametrize("curves", [1, 3])
@pytest.mark.parametrize("known", [True, False], ids=["known exposures", "unknown exposures"])
def test_derivatives_of_the_residuals_are_those_of_central_differences(known: bool, curves: int) -> None:
    """Radiance and exposures, which are eliminated, move with the curve."""
    rng = np.random.default_rng(21)
    o, _ = observations_of(response_of(film()), EXPOSURES, rng, n=80)
    every = np.arange(len(o.view))
    problem = OverlapProblem.build(doubled(o), every, EXPOSURES if known else None, len(EXPOSURES))
    knots = family.PRIOR_MEAN + torch.from_numpy(rng.normal(0, 0.05, (curves, family.N_KNOTS)))
    steps = 1e-6 * torch.eye(knots.numel(), dtype=torch.float64)
    start = knots.reshape(-1)
    central = torch.stack([(problem.residual(start + h) - problem.residual(start - h)) / 2e-6 for h in steps], 1)
    residual, found = linearised(problem.residual, start)
    assert torch.equal(residual, problem.residual(start))
    assert torch.linalg.norm(found - central) < 0.02 * torch.linalg.norm(central)


def test_tables_pass_gradcheck_between_their_samples() -> None:
    """The inverse has the derivative of the implicit function theorem, to first order."""
    generator = torch.Generator().manual_seed(0)
    knots = (family.PRIOR_MEAN + 0.1 * torch.randn(2, family.N_KNOTS, generator=generator)).requires_grad_()
    inside = (torch.randint(40, 900, (2, 12), generator=generator) + 0.4).double() / (N_SAMPLES - 1)
    x = inside.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda k, x: family.table(k).at(x), (knots, x))
    assert torch.autograd.gradcheck(lambda k, x: family.table(k).slope(x), (knots, x))
    assert torch.autograd.gradcheck(lambda k: family.contrast_residual(family.table(k)), (knots,))
    z = family.table(knots.detach()).at(inside)
    assert family.table(knots.detach()).inverse(z).numpy() == pytest.approx(inside.numpy(), abs=1e-6)
    assert torch.autograd.gradcheck(lambda k: family.table(k).inverse(z), (knots,))


def test_robust_norms_are_those_of_equation_14() -> None:
    r = torch.tensor([-30.0, -1.0, -1e-9, 0.0, 1e-4, 0.3, 5.0], dtype=torch.float64, requires_grad=True)
    assert torch.allclose(cauchy_root(r).square(), torch.log1p(r**2), atol=1e-15)
    assert torch.allclose(geman_mcclure_root(r).square(), r**2 / (1 + r**2), atol=1e-15)
    for root in (cauchy_root, geman_mcclure_root):
        assert torch.equal(root(r).sign(), r.sign())
        assert torch.autograd.gradcheck(root, (r,))


def test_exposures_under_a_given_curve() -> None:
    rng = np.random.default_rng(5)
    truth = curve.gamma()
    observations, _ = observations_of(truth, EXPOSURES, rng)
    fit = fit_overlap(doubled(observations), None, len(EXPOSURES), rng, truth)
    ratio = np.log2(fit.exposures / EXPOSURES[:, None])
    assert np.abs(ratio - ratio.mean()).max() < 0.05
    assert fit.response is truth


def test_exposures_of_a_walk_are_chained_from_photo_to_photo() -> None:
    """Each photo overlaps with the next four only, and the light changes by three stops on the way."""
    rng = np.random.default_rng(12)
    n_views, overlap = 60, 5
    exposures = 2.0 ** np.linspace(-1.5, 1.5, n_views)
    first = np.repeat(np.arange(1 - overlap, n_views), 12)
    patch = np.repeat(np.arange(len(first)), overlap)
    view = (first[:, None] + np.arange(overlap)).ravel()
    kept = (view >= 0) & (view < n_views)
    patch, view = patch[kept], view[kept]
    radiance = rng.uniform(0.1, 0.3, (len(first), 3))
    z = curve.gamma().apply(radiance[patch] * exposures[view, None])
    walk = observe_off_edges(patch, view, z, rng)
    fit = fit_overlap(doubled(walk), None, n_views, rng, curve.gamma())
    off = np.log2(fit.exposures / exposures[:, None])
    assert np.abs(off - off.mean()).max() < 0.02


def test_photos_of_one_known_exposure_keep_the_median_curve() -> None:
    """They cannot tell a curve; without that a power of it fitted as well as the curve itself."""
    rng = np.random.default_rng(13)
    common = family.to_response(family.PRIOR_MEAN[None])
    observations, _ = observations_of(common, np.ones(8), rng)
    fit = fit_overlap(doubled(observations), np.full(8, 3.0), 8, rng)
    assert np.array_equal(fit.response.samples, common.samples)
    assert fit.exposures == pytest.approx(3.0)


def test_a_response_is_constant_outside_its_table() -> None:
    exposure = np.array([[-1.0, 0.0, 0.3], [1.0, 7.0, np.nan]])
    expected = np.interp(exposure, np.linspace(0, 1, 1024), X ** (1 / 2.2))
    assert np.allclose(curve.gamma().apply(exposure), expected, atol=1e-12, equal_nan=True)


# ---- photos that tell nothing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("known", [True, False])
def test_photos_that_all_look_alike_leave_finite_exposures(level: float, known: bool) -> None:
    """Whatever their exposures are recorded as: no overlap contradicts, and no division by their spread is made."""
    rng = np.random.default_rng(0)
    o, _ = observations_of(response_of(CURVES["sRGB"]), EXPOSURES, rng)
    clipped = np.full_like(o.saturated, level == 1.0)
    o = doubled(replace(o, z=np.full_like(o.z, level), spread=np.zeros_like(o.spread), saturated=clipped))
    fit = fit_overlap(o, EXPOSURES if known else None, len(EXPOSURES), rng)
    assert np.isfinite(fit.exposures).all() and (fit.exposures > 0).all()
    assert np.isfinite(fit.response.samples).all()


def test_a_table_has_no_value_where_there_is_none() -> None:
    table = family.table(family.PRIOR_MEAN[None])
    found = table.at(torch.tensor([[0.5, float("nan"), float("inf")]], dtype=torch.float64).expand(3, -1))
    assert torch.isfinite(found[:, 0]).all() and found[:, 1].isnan().all() and (found[:, 2] == 1).all()


def test_a_photo_that_clips_all_is_no_shorter_than_that_takes() -> None:
    """The brightest photo of a bracket without times: it shows nothing unclipped, so that nothing else tells."""
    rng = np.random.default_rng(4)
    exposures = np.append(EXPOSURES, 400.0)
    o, radiance = observations_of(response_of(CURVES["sRGB"]), exposures, rng)
    o = doubled(o)
    last = o.view == len(EXPOSURES)
    o = replace(o, z=np.where(last[:, None], 1, o.z), saturated=np.where(last[:, None], 1, o.saturated))
    found = fit_overlap(o, None, len(exposures), rng, response_of(CURVES["sRGB"])).exposures.mean(1)
    unit = found[:-1].mean() / exposures[:-1].mean()
    least = np.quantile(1 / (unit * radiance.min(1)), 0.8)
    assert found[-1] > least


def test_correcting_exposures_keeps_what_recorded_ones_say_between_photos_that_share_nothing() -> None:
    """Two light states share no patch, and the second is an eighth as bright and exposed eight times as long;
    recorded exposures are off by a third of a stop each."""
    rng = np.random.default_rng(5)
    recorded = np.concatenate([EXPOSURES, 8 * EXPOSURES]) * 2 ** rng.normal(0, 0.33, 2 * len(EXPOSURES))
    first, _ = observations_of(response_of(srgb()), np.tile(EXPOSURES, 2), rng)
    patch = np.where(first.view < len(EXPOSURES), first.patch, first.patch + 300).astype(np.int32)
    apart = replace(doubled(first), patch=patch)
    fit = fit_overlap(apart, recorded, len(recorded), rng, decisions=Decisions({"channel_curves": False}))
    found, given = (np.log2(np.asarray(t).reshape(len(recorded), -1)[:, 0]) for t in (fit.exposures, recorded))
    assert np.abs(found - given).max() > 0.2, "nothing was corrected"
    n = len(EXPOSURES)
    assert found[n:].mean() - found[:n].mean() == pytest.approx(given[n:].mean() - given[:n].mean(), abs=0.05)
