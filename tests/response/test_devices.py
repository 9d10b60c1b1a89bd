"""Photos of two cameras: a curve, a gain and local exposure for each, where the photos bear them out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from iris_addon.base.minimise import linearised
from iris_addon.decide import Decisions
from iris_addon.model.capture import Camera, View
from iris_addon.model.device import MAX_DEVICES, MIN_DEVICE_PHOTOS, Devices, devices_of
from iris_addon.model.local_exposure import COLUMNS, ROWS, UNIFORM, LocalExposure, LocalSettings
from iris_addon.model.response import N_SAMPLES, Response, gamma
from iris_addon.response import family
from iris_addon.response.curve_table import CurveTable, DeviceCurves
from iris_addon.response.observations import Observations
from iris_addon.response.overlap import OverlapFit, fit_overlap
from iris_addon.response.overlap_problem import OverlapProblem
from iris_addon.response.photometry import Photometry
from tests.response.photographed_patches import EXPOSURES, observations_of
from tests.response.test_local_exposure import CAMERA, N_VIEWS, Wall, small
from tests.response.test_local_exposure import EXPOSURES as WALL_EXPOSURES

X, N_PATCHES = np.linspace(0, 1, N_SAMPLES), 150
ONE = gamma(1 / 2.2)
TWO = Response(np.tile(X ** (1 / 3), (3, 1)), "file")
"""Apart as photos of a phone and of a camera are."""
GAIN = np.array([1.3, 1.2, 1.0])
"""Of the second camera over the first: another ISO 100, another white balance."""
INDEX = np.arange(len(EXPOSURES)) % 2
DEVICES = Devices(INDEX, ("Acme One", "Acme Two"))


def of_two(second: Response, gain: np.ndarray, seed: int = 1) -> Observations:
    """Patches of which every second photo is of another camera."""
    exposures = np.repeat(EXPOSURES[:, None], 3, 1)
    taken = [
        observations_of(response, exposures * factor, np.random.default_rng(seed), n=N_PATCHES)[0]
        for response, factor in ((ONE, np.ones(3)), (second, gain))
    ]
    own = INDEX[taken[0].view] == 1
    columns = ("z", "spread", "saturated", "black")
    both = {
        name: np.where(own[:, None], getattr(taken[1], name), getattr(taken[0], name)).astype(np.float32)
        for name in columns
    }
    return replace(taken[0], count=taken[0].count * 4, **both)  # overlap wants two pixels behind an observation


def fitted(observations: Observations, known: bool = True, devices: Devices | None = DEVICES) -> OverlapFit:
    exposures = EXPOSURES if known else None
    rng, decisions = np.random.default_rng(0), Decisions({"local_exposure": False, "channel_curves": False})
    return fit_overlap(observations, exposures, len(EXPOSURES), rng, None, decisions, None, devices)


def off(found: Response, truth: Response) -> float:
    return float(np.linalg.norm(found.samples - truth.samples))


def test_two_curves_and_the_gain_between_them_are_found() -> None:
    fit = fitted(of_two(TWO, GAIN))
    assert len(fit.others) == 1
    assert off(fit.response, ONE) < 0.4 and off(fit.others[0], TWO) < 0.4
    assert fit.exposures[INDEX == 0] == pytest.approx(np.repeat(EXPOSURES[INDEX == 0, None], 3, 1))
    gain = fit.exposures[INDEX == 1] / EXPOSURES[INDEX == 1, None]
    assert gain == pytest.approx(np.tile(GAIN, (len(gain), 1)), rel=0.02)
    assert fit.residual < 0.3 * fitted(of_two(TWO, GAIN), devices=None).residual


def test_two_curves_are_found_without_exposures() -> None:
    """Up to the exponent that no photo fixes: either curve raised to it shows the same radiance."""
    fit = fitted(of_two(TWO, GAIN), known=False)
    assert len(fit.others) == 1
    exponent = np.log(0.5) / np.log(fit.response.invert(np.full((1, 3), ONE.samples[0, 512]))[0, 1])
    middle = fit.others[0].invert(np.full((1, 3), TWO.samples[0, 512]))[0, 1] ** exponent
    assert middle == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_two_cameras_of_one_curve_share_it(seed: int) -> None:
    observations = of_two(ONE, np.ones(3), seed)
    shared, alone = fitted(observations), fitted(observations, devices=None)
    assert not shared.others
    assert np.array_equal(shared.response.samples, alone.response.samples)
    assert np.array_equal(shared.exposures, alone.exposures)


def test_a_camera_with_another_falloff_has_its_own() -> None:
    wall, rng = Wall.painted(1), np.random.default_rng(0)
    index = np.arange(N_VIEWS) // 3 % 2  # from every distance by both
    plain, dark = (wall.photos(settings) for settings in (UNIFORM, LocalSettings(falloff=0.7)))
    bent = np.floor(255 * (dark + 0.5 / 255) ** 1.4) / 255
    photos = np.where((index == 1)[:, None, None, None], np.where(dark == 1, 1, bent), plain)
    decisions = Decisions({"channel_curves": False})
    fit = fit_overlap(
        wall.observations(photos, rng),
        WALL_EXPOSURES,
        N_VIEWS,
        rng,
        None,
        decisions,
        small(photos),
        Devices(index, ("a", "b")),
    )
    assert fit.local is not None
    assert fit.local.settings.falloff < 0.05
    assert fit.local.others[0].falloff == pytest.approx(0.7, abs=0.1)
    assert np.abs(fit.local.log_gain[index == 0]).max() < 0.05
    assert np.linalg.norm(fit.others[0].samples - CAMERA.samples**1.4) < 1.5


# What they are made of -----------------------------------------------------------------------------------------------


def test_curves_of_devices_look_up_the_curve_of_each_column() -> None:
    tables = (CurveTable.of(ONE), CurveTable.of(TWO))
    device = torch.tensor([0, 1, 1, 0, 1])
    both = DeviceCurves(tables, device)
    values = torch.rand((3, 5), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for look_up in ("at", "slope", "inverse"):
        expected = torch.stack(
            [getattr(tables[d], look_up)(values[:, k : k + 1])[:, 0] for k, d in enumerate(device.tolist())], 1
        )
        assert torch.equal(getattr(both, look_up)(values), expected)


@pytest.mark.parametrize("known", [True, False])
def test_derivatives_of_the_residuals_are_those_of_central_differences(known: bool) -> None:
    """Gains of devices, which are eliminated, move with the curves."""
    observations = of_two(TWO, GAIN)
    some = np.flatnonzero(observations.patch < 80)
    problem = OverlapProblem.build(observations, some, EXPOSURES if known else None, len(EXPOSURES))
    problem = replace(problem, device=torch.from_numpy(INDEX))
    generator = torch.Generator().manual_seed(3)
    start = problem.with_shared(family.PRIOR_MEAN).reshape(-1)
    start = start + 0.05 * torch.randn(start.shape, generator=generator, dtype=torch.float64)
    steps = 1e-6 * torch.eye(len(start), dtype=torch.float64)
    central = torch.stack([(problem.residual(start + h) - problem.residual(start - h)) / 2e-6 for h in steps], 1)
    residual, found = linearised(problem.residual, start)
    assert torch.equal(residual, problem.residual(start))
    assert torch.linalg.norm(found - central) < 0.02 * torch.linalg.norm(central)


def photometry(rng: np.random.Generator) -> Photometry:
    settings = (LocalSettings(falloff=1.0), LocalSettings(strength=0.2))
    log_gain = rng.normal(0, 0.2, (4, ROWS, COLUMNS)).astype(np.float32)
    return Photometry(
        response=Response(ONE.samples, family.FITTED, (1.0, 2.0)),
        exposures=rng.uniform(0.5, 1.0, (4, 3)),
        held_out=0.0,
        per_channel=False,
        known_exposures=True,
        local=LocalExposure(
            settings=settings[0], log_gain=log_gain, sizes=np.tile([30, 40], (4, 1)), others=settings[1:]
        ),
        others=(Response(TWO.samples, family.FITTED, (3.0, 4.0)),),
        device=np.array([0, 1, 1, 0]),
    )


def test_every_photo_passes_through_the_curve_of_its_camera() -> None:
    rng = np.random.default_rng(0)
    both = photometry(rng)
    view, pixel = rng.integers(0, 4, 300), rng.integers(0, 40 * 30, 300)
    radiance = rng.uniform(0.05, 0.6, (300, 3))
    z = both.develop(radiance, view, pixel)
    for k, response in enumerate((ONE, TWO)):
        alone = replace(both, response=Response(response.samples, family.FITTED), others=(), device=None)
        own = both.device[view] == k  # type: ignore[index]
        assert np.array_equal(z[own], alone.develop(radiance[own], view[own], pixel[own]))
        pixels = both.linearise_pixels(z, view, pixel), alone.linearise_pixels(z[own], view[own], pixel[own])
        exposed = [p.exposures_of(z[own].astype(np.float32)[None], int(view[own][0])) for p in (both, alone)]
        assert np.array_equal(*exposed)
        x = exposed[0][0]
        means = both.linearise_exposures(np.tile(x, (2, 1))[:300], view, pixel) if len(x) >= 150 else None
        for column in ("radiance", "unclipped", "bound", "ceiling", "precision"):
            assert np.array_equal(getattr(pixels[0], column)[own], getattr(pixels[1], column))
            if means is not None:
                expected = alone.linearise_exposures(np.tile(x, (2, 1))[:300][own], view[own], pixel[own])
                assert np.array_equal(getattr(means, column)[own], getattr(expected, column))


def test_observations_are_linearised_by_their_camera() -> None:
    observations = of_two(TWO, np.ones(3))
    both = Photometry(
        response=ONE,
        exposures=np.repeat(EXPOSURES[:, None], 3, 1),
        held_out=0.0,
        per_channel=False,
        known_exposures=True,
        others=(TWO,),
        device=INDEX,
    )
    linear = both.linearise_observations(observations)
    _, radiance = observations_of(ONE, EXPOSURES, np.random.default_rng(1), n=N_PATCHES)
    seen = linear.unclipped & (observations.z > 0.2)
    assert linear.radiance[seen] == pytest.approx(radiance[observations.patch][seen], rel=0.05)


def test_photometry_of_two_cameras_survives_a_checkpoint_and_an_exponent(tmp_path: Path) -> None:
    both = photometry(np.random.default_rng(0))
    np.savez(tmp_path / "response.npz", **both.arrays())
    with np.load(tmp_path / "response.npz", allow_pickle=False) as file:
        read = Photometry.from_arrays(dict(file))
    assert np.array_equal(read.others[0].samples, TWO.samples) and read.others[0].coefficients == (3.0, 4.0)
    assert np.array_equal(read.device, both.device)  # type: ignore[arg-type]
    assert read.local is not None and read.local.others == (LocalSettings(strength=0.2),)
    raised = both.raised(1.5)
    assert raised.others[0].samples == pytest.approx(TWO.raised(1.5).samples)
    assert raised.local is not None and len(raised.local.others) == 1


def views(*devices: str) -> list[View]:
    camera = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=2.0, cy=1.5, c2w=np.eye(4))
    return [View(f"{k}", camera, None, device=device) for k, device in enumerate(devices)]


def test_cameras_are_told_by_maker_and_model() -> None:
    assert devices_of(views(*"aaaa")) is None and devices_of(views("", "", "")) is None
    found = devices_of(views(*"abbababb"))
    assert found is not None and found.names == ("b", "a")
    assert found.index.tolist() == [1, 0, 0, 1, 0, 1, 0, 0]


def test_cameras_of_few_photos_and_of_a_crowd_share_the_first_curve() -> None:
    few = ["few"] * (MIN_DEVICE_PHOTOS - 1)
    assert devices_of(views(*"aaaa", *few)) is None
    crowd = [str(k) for k in range(MAX_DEVICES + 2) for _ in range(MIN_DEVICE_PHOTOS + (k == 0))]
    found = devices_of(views(*crowd, *few))
    assert found is not None and found.names == tuple(str(k) for k in range(MAX_DEVICES))
    assert found.index[-1] == found.index[-len(few) - 1] == 0
