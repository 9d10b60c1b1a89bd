"""Whether a lamp has a profile, told from the light that it casts and from what photos show of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.lighting.lamp_radiance import PatchFit
from iris_addon.lighting.problem import Bounce, Lights
from iris_addon.lighting.profiled_lamps import _Asked, _by_angle, with_profiles
from iris_addon.lighting.screens import Shown
from iris_addon.model.lamp_profile import LampProfile
from iris_addon.response.radiance import Linearised
from tests.light_room import LitRoom, Panel, light_room, panels

LAMP: Panel = ([1.9, 1.4, 2.4], [0.2, 0, 0], [0, 0.2, 0])
LEVEL = 40.0
SPOT = LampProfile.of(np.array([1.0, 0.85, 0.45, 0.12, 0.03, 0.01]))
REGION = 6


def light_of_spot(points: np.ndarray, normals: np.ndarray, panel: Panel = LAMP, level: float = LEVEL) -> np.ndarray:
    """(n,) irradiance / pi that the spot brings more than an even lamp of ``level``."""
    corner, first, second = (np.array(part) for part in panel)
    area = float(np.linalg.norm(np.cross(first, second)))
    total = np.zeros(len(points))
    steps = (np.arange(6) + 0.5) / 6
    for u in steps:
        for v in steps:
            way = corner + u * first + v * second - points
            square = np.maximum((way**2).sum(1), 1e-6)
            way = way / np.sqrt(square)[:, None]
            surface, lamp = np.maximum((way * normals).sum(1), 0), np.abs(way[:, 2])
            total += surface * lamp * (SPOT.at(lamp) - 1) / square
    return level * total * area / len(steps) ** 2 / np.pi


def nothing_shown() -> Shown:
    none, flat = np.zeros(0, np.int64), np.zeros((0, 3))
    linear = Linearised(radiance=flat, unclipped=flat > 0, bound=flat, ceiling=flat, precision=flat)
    observations = SimpleNamespace(patch=none, view=none, sample=none, count=np.zeros(0))
    return Shown(observations, linear, flat)  # type: ignore[arg-type]


def lit(spot: bool) -> LitRoom:
    return light_room(*panels(LAMP), {REGION: LEVEL}, noise=0.005, direct=light_of_spot if spot else None)


def solved(
    room: LitRoom, *regions: int, shown: Shown | None = None, bounce: Bounce | None = None, **refinements: bool
) -> tuple[Lights, Decisions]:
    decisions = Decisions(refinements)
    problem = replace(room.problem, decisions=decisions, bounce=bounce)
    lights = room.solved(*(regions or (REGION,)))
    return with_profiles(problem, room.observed, lights, shown or nothing_shown(), PatchFit(), Progress()), decisions


def test_a_spot_is_found_by_the_light_that_it_casts() -> None:
    lights, decisions = solved(lit(spot=True))
    profile = lights.profile_of(lights.emitters[0])
    assert profile is not None
    assert [entry["accepted"] for entry in decisions.report()] == [True]
    # Of the light of this spot 0.4 % goes beyond 60 degrees.
    np.testing.assert_allclose(profile.values[1:4], SPOT.values[1:4], rtol=0.05, atol=0.15)
    assert profile.values[4:].max() < 0.3
    np.testing.assert_allclose(lights.radiance[0], LEVEL, rtol=0.2)


def test_an_even_lamp_stays_even_and_its_light_as_it_was() -> None:
    room = lit(spot=False)
    before = room.solved(REGION)
    lights, decisions = solved(room)
    assert lights.profiles is None
    assert [entry["accepted"] for entry in decisions.report()] == [False]
    np.testing.assert_array_equal(lights.radiance, before.radiance)


def test_a_profile_that_is_forbidden_is_not_sought() -> None:
    lights, decisions = solved(lit(spot=True), lamp_profile=False)
    assert lights.profiles is None and decisions.report() == []


def test_profiles_belong_to_the_faces_of_a_lamp_and_survive_a_checkpoint() -> None:
    lights, _ = solved(lit(spot=True))
    again = Lights.from_arrays(lights.arrays())
    np.testing.assert_array_equal(again.profiles, lights.profiles)
    other = np.array([0, 1])
    both = again.profiles_of([other, lights.emitters[0]])
    assert both is not None and (both[0] == 1).all()
    np.testing.assert_array_equal(both[1], lights.profiles[0])
    assert again.profile_of(other) is None and again.profiles_of([other]) is None


@pytest.mark.parametrize("spot", [True, False])
def test_the_same_seed_gives_the_same_profile(spot: bool) -> None:
    first, second = (solved(lit(spot))[0] for _ in range(2))
    np.testing.assert_array_equal(first.radiance, second.radiance)
    assert (first.profiles is None) == (second.profiles is None)


TWINS: tuple[Panel, Panel] = (([0.6, 0.6, 2.4], [0.6, 0, 0], [0, 0.6, 0]), ([2.6, 1.8, 2.4], [0.6, 0, 0], [0, 0.6, 0]))
"""Copies of one lamp, of more faces than the two from which on copies are told."""


def test_copies_of_a_lamp_share_a_profile() -> None:
    def more(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return sum(light_of_spot(points, normals, panel, 4.0) for panel in TWINS)  # type: ignore[return-value]

    room = light_room(*panels(*TWINS), {6: 4.0, 7: 4.0}, noise=0.005, direct=more)
    lights, decisions = solved(room, 6, 7)
    assert lights.profiles is not None
    assert len(decisions.report()) == 1, "one lamp is asked"
    np.testing.assert_array_equal(lights.profiles[0], lights.profiles[1])
    np.testing.assert_allclose(lights.radiance[0], lights.radiance[1])
    np.testing.assert_allclose(lights.profiles[0, 1:4], SPOT.values[1:4], rtol=0.2)


def test_copies_that_are_not_equally_bright_have_no_profile_for_it() -> None:
    """Two even lamps of one model, one of them dimmed: what a profile would earn is that they differ."""
    lights, _ = solved(light_room(*panels(*TWINS), {6: 8.0, 7: 2.0}, noise=0.005), 6, 7)
    assert lights.profiles is None


def test_what_photos_show_of_a_lamp_counts_for_the_angle_they_look_from() -> None:
    """Two views at 14 degrees measure it, one at 61 clips; none looks from elsewhere, or is of the lamp."""
    room = lit(spot=True)
    on = np.flatnonzero(np.isin(room.problem.samples.face, room.faces(REGION)))
    if len(on) < 3:
        pytest.skip("too few pixels of this room show the lamp")
    off = np.flatnonzero(~np.isin(room.problem.samples.face, room.faces(REGION)))[:1]
    sample = np.concatenate([on[:3], off])
    room.problem.samples.cosine[sample] = np.cos(np.radians([14, 14, 61, 14]))
    value = np.repeat(np.array([70.0, 74.0, 0.0, 500.0])[:, None], 3, 1)
    unclipped, bound = value > 0, np.where(value > 0, 0, 3.0)
    linear = Linearised(radiance=value, unclipped=unclipped, bound=bound, ceiling=value, precision=value)
    patch = room.problem.surface.sample_patch[sample]
    observations = SimpleNamespace(patch=patch, view=patch, sample=sample, count=np.ones(len(sample)))
    lights, asked = room.solved(REGION), [_Asked(np.array([0]), np.zeros((1, 1, 6, 2), np.float32))]
    expected = np.full((6, 3), LEVEL)
    shown = Shown(observations, linear, np.zeros(value.shape))  # type: ignore[arg-type]
    evidence = _by_angle(room.problem, lights, asked, expected, shown)
    np.testing.assert_array_equal(evidence.measured[1], 72)
    assert np.isnan(np.delete(evidence.measured, 1, axis=0)).all()
    np.testing.assert_array_equal(evidence.bound[:, 0], [0, 0, 0, 0, 3, 0])


class _Mirrored:
    """Light of the lamp by way of a glossy surface, the same everywhere."""

    SHARE = 0.001

    def gather_radiance(self, radiance, unknown, emitter_faces):
        return np.zeros(radiance.shape, np.float32)

    def form_factors(self, emitters, n_faces):
        return np.full((self.n, len(emitters)), self.SHARE, np.float32)

    def __init__(self, n: int) -> None:
        self.n = n


def test_what_glossy_surfaces_pass_on_of_a_spot_is_not_taken_for_its_profile() -> None:
    """They brighten all of the room alike; the profile is that of the light which comes from the lamp itself."""
    room = lit(spot=True)
    t = room.problem.transport
    albedo = np.where(t.region[:, None] == REGION, 0.0, room.room.albedo[t.region])
    more, mask = np.zeros_like(room.radiance), np.isin(room.room.regions, [REGION])
    for _ in range(30):
        more = albedo * (t.gather_radiance(more, more.mean(0), mask) + _Mirrored.SHARE * LEVEL)
    observed = replace(room.observed, radiance=room.observed.radiance + more[: t.n_seen])
    lights, _ = solved(replace(room, observed=observed), bounce=_Mirrored(t.n_patches), lamp_profile=True)
    assert lights.profiles is not None
    np.testing.assert_allclose(lights.profiles[0, 1:4], SPOT.values[1:4], atol=0.3)
