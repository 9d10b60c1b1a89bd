"""Whether a lamp has a profile, told from the light that it casts and from what photos show of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.lighting.lamp_radiance import PatchFit
from iris_addon.lighting.problem import Lights
from iris_addon.lighting.profiled_lamps import with_profiles
from iris_addon.lighting.screens import Shown
from iris_addon.model.lamp_profile import LampProfile
from iris_addon.response.radiance import Linearised
from tests.light_room import LitRoom, Panel, light_room, panels

LAMP: Panel = ([1.9, 1.4, 2.4], [0.2, 0, 0], [0, 0.2, 0])
LEVEL = 40.0
SPOT = LampProfile.of(np.array([1.0, 0.85, 0.45, 0.12, 0.03, 0.01]))
REGION = 6


def light_of_spot(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) irradiance / pi that the spot brings more than an even lamp of LEVEL."""
    corner, first, second = (np.array(part) for part in LAMP)
    total = np.zeros(len(points))
    steps = (np.arange(6) + 0.5) / 6
    for u in steps:
        for v in steps:
            way = corner + u * first + v * second - points
            square = np.maximum((way**2).sum(1), 1e-6)
            way = way / np.sqrt(square)[:, None]
            surface, lamp = np.maximum((way * normals).sum(1), 0), np.abs(way[:, 2])
            total += surface * lamp * (SPOT.at(lamp) - 1) / square
    return LEVEL * total * 0.04 / len(steps) ** 2 / np.pi


def nothing_shown() -> Shown:
    none, flat = np.zeros(0, np.int64), np.zeros((0, 3))
    linear = Linearised(radiance=flat, unclipped=flat > 0, bound=flat, ceiling=flat, precision=flat)
    observations = SimpleNamespace(patch=none, view=none, sample=none, count=np.zeros(0))
    return Shown(observations, linear, flat)  # type: ignore[arg-type]


def lit(spot: bool) -> LitRoom:
    return light_room(*panels(LAMP), {REGION: LEVEL}, noise=0.005, direct=light_of_spot if spot else None)


def solved(room: LitRoom, **refinements: bool) -> tuple[Lights, Decisions]:
    problem = room.problem
    decisions = Decisions(refinements)
    object.__setattr__(problem, "decisions", decisions)
    lights = room.solved(REGION)
    return with_profiles(problem, room.observed, lights, nothing_shown(), PatchFit(), Progress()), decisions


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
