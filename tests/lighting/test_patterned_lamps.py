"""A lamp has a pattern where photos agree on one; noise, changing pictures and what merely clips are none."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.decide import Decisions
from iris_addon.lighting.brightness import Brightness
from iris_addon.lighting.lamp_evidence import _mean_over, _tied
from iris_addon.lighting.lamp_pattern import LampPattern
from iris_addon.lighting.patterned_lamps import MIN_PATCHES, _halves, _pattern_of, patterned_lamps
from iris_addon.lighting.problem import LightProblem, Lights
from iris_addon.lighting.screens import Shown
from iris_addon.rays.tracer import Tracer
from iris_addon.response.radiance import Linearised
from tests.engine_room import assemble, quad

VIEWS, PATCHES = 8, 60
WALL = 20
"""Patches that lie on no lamp, beside those that do."""
N = PATCHES + WALL
LEVEL = 2.0


def problem(**refinements: bool) -> LightProblem:
    """A lamp and a wall; every face is a patch with one pixel."""
    return SimpleNamespace(  # type: ignore[return-value]
        surface=SimpleNamespace(sample_patch=np.arange(N), count=np.ones(N)),
        samples=SimpleNamespace(face=np.arange(N)),
        regions=np.repeat([0, 1], [PATCHES, WALL]),
        decisions=Decisions(refinements),
        seed=0,
    )


def lit(patches: int = PATCHES) -> Lights:
    """One lamp on the first faces."""
    ones = np.ones((N, 3))
    return Lights(
        emitters=[np.arange(patches)],
        radiance=np.full((1, 3), LEVEL),
        hidden_radiance=np.zeros((0, 3)),
        log_std=np.zeros(1),
        form_factors=np.zeros((N, 1, 2), np.float32),
        mask=np.arange(N) < patches,
        irradiance=ones,
        patch_radiance=ones,
    )


def shown(radiance: np.ndarray, noise: float = 0.03, clip: float = np.inf) -> Shown:
    """What photos show of patches of ``radiance`` (N, VIEWS), up to ``clip``."""
    seen = radiance * np.random.default_rng(0).normal(1, noise, radiance.shape)
    flat = np.repeat(seen.reshape(-1, 1), 3, axis=1)
    unclipped = flat < clip
    patch, view = (index.ravel() for index in np.indices(radiance.shape))
    observations = SimpleNamespace(patch=patch, view=view, count=np.full(patch.shape, 9.0))
    bound = np.where(unclipped, 0, clip)
    ceiling, precision = np.full(flat.shape, np.inf), np.ones(flat.shape)
    linear = Linearised(radiance=flat, unclipped=unclipped, bound=bound, ceiling=ceiling, precision=precision)
    return Shown(observations, linear, np.zeros(flat.shape))  # type: ignore[arg-type]


def even() -> np.ndarray:
    """(N, VIEWS) a lamp that is bright everywhere, before a wall."""
    return np.repeat(np.where(np.arange(N) < PATCHES, LEVEL, 0.3)[:, None], VIEWS, axis=1)


def striped(dark: float = 0.5) -> np.ndarray:
    """(N, VIEWS) a lamp of which every third patch is darker."""
    radiance = even()
    radiance[:PATCHES:3] *= dark
    return radiance


def test_a_lamp_that_photos_agree_to_be_uneven_has_a_pattern() -> None:
    assert patterned_lamps(problem(), lit(), shown(striped())).tolist() == [0]


@pytest.mark.parametrize("noise", [0.0, 0.03, 0.2])
def test_noise_is_no_pattern(noise: float) -> None:
    assert not len(patterned_lamps(problem(), lit(), shown(even(), noise)))


def test_a_picture_that_changes_from_photo_to_photo_is_no_pattern() -> None:
    radiance = even()
    radiance[:PATCHES] *= np.exp(np.random.default_rng(1).normal(0, 0.7, (PATCHES, VIEWS)))
    assert not len(patterned_lamps(problem(), lit(), shown(radiance)))


def test_dark_trees_before_a_sky_that_clips_are_a_pattern_and_a_sky_alone_is_none() -> None:
    sky = even()
    assert not len(patterned_lamps(problem(), lit(), shown(sky, clip=1.0)))
    assert len(patterned_lamps(problem(), lit(), shown(striped(0.1), clip=1.0)))


def test_photos_that_take_turns_at_two_exposures_tell_as_much_as_in_any_other_order() -> None:
    """All long exposures clip. With these in one half nothing could be predicted."""
    seen = striped(0.1)
    for order in (np.arange(VIEWS), np.argsort(np.arange(VIEWS) % 2, kind="stable")):
        long = order % 2 == 1
        clips = np.where(long, 0.05, np.inf)
        photos = shown(seen)
        view = photos.observations.view
        unclipped = photos.linear.radiance < clips[view][:, None]
        bound = np.where(unclipped, 0, clips[view][:, None])
        photos = replace(photos, linear=replace(photos.linear, unclipped=unclipped, bound=bound))
        assert len(patterned_lamps(problem(), lit(), photos)), order


def in_place(measured: np.ndarray, bound: np.ndarray) -> LightProblem:
    """The lamp as a square of patches side by side, of which photos show ``measured`` and ``bound`` (PATCHES, 3)."""
    mesh = assemble([quad([0, 0, 0], [1, 0, 0], [0, 0.6, 0], 0.1)], [0])
    tracer = Tracer(mesh)
    n = len(tracer.areas)
    assert n >= PATCHES
    numbers = np.minimum(np.arange(n) * PATCHES // n, PATCHES - 1)
    position = np.array([tracer.corners[numbers == k].mean((0, 1)) for k in range(PATCHES)])
    return SimpleNamespace(  # type: ignore[return-value]
        surface=SimpleNamespace(sample_patch=numbers, count=np.bincount(numbers), position=position),
        samples=SimpleNamespace(face=np.arange(n)),
        regions=np.zeros(n, np.int32),
        tracer=tracer,
        brightness=Brightness(measured, measured, bound),
    )


@pytest.mark.parametrize("channels", [slice(None), slice(2, 3)])
def test_what_clips_is_no_hot_spot_and_no_dark_one(channels: slice) -> None:
    """A patch that clips while the radiance found is that of bright patches, and a half of which only blue clips."""
    measured, bound = np.ones((PATCHES, 3)), np.zeros((PATCHES, 3))
    measured[:20] = 0.3
    measured[-1, channels], bound[-1, channels] = np.nan, 1.5
    lights = replace(lit(), emitters=[np.arange(len(in_place(measured, bound).regions))], radiance=np.full((1, 3), 1.0))
    share = _pattern_of(in_place(measured, bound), lights, 0).share
    assert 1 < share[-1] / share[-2] <= 1.5 and share.min() > 0.3
    measured[30:, channels], bound[30:, channels] = np.nan, 1.0
    dim = replace(lights, radiance=np.full((1, 3), 0.35))
    share = _pattern_of(in_place(measured, bound), dim, 0).share
    assert share[40] >= share[25] > share[5]


def test_a_patch_of_which_every_photo_clips_a_part_is_no_dark_one() -> None:
    """It has neither a measurement nor a bound."""
    measured, bound = np.ones((PATCHES, 3)), np.zeros((PATCHES, 3))
    measured[:20], measured[-1] = 0.3, np.nan
    problem = in_place(measured, bound)
    lights = replace(lit(), emitters=[np.arange(len(problem.regions))], radiance=np.full((1, 3), 1.0))
    pattern = _pattern_of(problem, lights, 0)
    assert pattern.share[-1] == pytest.approx(pattern.share[-2])
    assert _mean_over(problem.brightness, pattern)[0].min() > 0.7


def test_three_photos_of_sixty_that_show_a_lamp_are_never_in_one_half() -> None:
    for seed in range(20):
        half = _halves(np.zeros(3, np.int64), np.array([7, 30, 52]), seed)
        assert 0 < half.sum() < 3
    lamps, views = np.repeat([0, 1], 4), np.tile([1, 2, 3, 4], 2)
    assert [int(half.sum()) for half in np.split(_halves(lamps, views, 0), 2)] == [2, 2]


def test_a_lamp_with_a_pattern_has_a_radiance_of_its_own_beside_its_twins() -> None:
    lamps = [np.arange(4) + 4 * k for k in range(3)]
    tracer = SimpleNamespace(areas=np.ones(12), corners=np.zeros((12, 3, 3)))
    twins = SimpleNamespace(tracer=tracer, pattern_of=lambda faces: None)
    assert _tied(twins, lamps).tolist() == [0, 0, 0]  # type: ignore[arg-type]
    twins.pattern_of = lambda faces: "pattern" if faces[0] == 4 else None
    label = _tied(twins, lamps)  # type: ignore[arg-type]
    assert label[0] == label[2] != label[1] and set(label) == {0, 1}


def test_a_lamp_of_few_patches_is_not_asked_and_one_may_forbid_the_question() -> None:
    few = problem()
    assert not len(patterned_lamps(few, lit(MIN_PATCHES - 1), shown(striped())))
    assert few.decisions.report() == []
    assert not len(patterned_lamps(problem(lamp_pattern=False), lit(), shown(striped())))


def of_all(n: int, area: np.ndarray | None = None) -> LampPattern:
    area = np.full(n, 1 / n) if area is None else area
    faces = np.arange(n)
    return LampPattern(faces=faces, patch=faces, position=np.zeros((n, 3)), area=area, share=np.ones(n))


def test_the_radiance_of_a_pattern_is_its_mean_and_a_bound_where_much_of_it_clips() -> None:
    measured = np.repeat(np.r_[np.full(90, 1.0), np.full(10, 3.0)][:, None], 3, axis=1)
    seen = Brightness(measured, measured, np.zeros((100, 3)))
    least, mean = _mean_over(seen, of_all(100))
    np.testing.assert_allclose([least, mean], 1.2)
    by_area = np.r_[np.full(90, 0.5 / 90), np.full(10, 0.05)]
    np.testing.assert_allclose(_mean_over(seen, of_all(100, by_area))[1], 2.0)
    measured[-10:] = np.nan
    least, mean = _mean_over(Brightness(measured, measured, np.full((100, 3), 2.0)), of_all(100))
    np.testing.assert_allclose(least, 1.1)
    assert np.isnan(mean).all()


def test_a_pattern_is_that_of_the_nearest_place() -> None:
    two, half = np.arange(2), np.full(2, 0.5)
    pattern = LampPattern(faces=two, patch=two, position=np.eye(3)[:2], area=half, share=np.array([0.5, 1.5]))
    assert pattern.at(np.array([[0.9, 0.1, 5.0], [0.1, 0.9, -5.0]])).tolist() == [0.5, 1.5]
