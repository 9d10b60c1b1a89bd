"""Copies of one lamp share a radiance, unless the light of the room tells that they do not shine alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from iris_addon.base.progress import Progress
from iris_addon.lighting.common_lamps import solve_states
from iris_addon.lighting.lamp_radiance import LitState, patch_weight
from iris_addon.lighting.problem import Lights
from iris_addon.lighting.search import find_lights, reconsider_lamps
from tests.light_room import LitRoom, Panel, light_room, panels

FIRST, SECOND = 6, 7
"""Regions of two lamps of one size, at either end of the room."""
ENDS: tuple[Panel, Panel] = ([0.3, 1.0, 2.4], [0.5, 0, 0], [0, 1.0, 0]), ([3.0, 1.0, 2.4], [0.5, 0, 0], [0, 1.0, 0])
CLIP = 2.0
"""Radiance from which on all photos clip: both lamps are told by their light alone."""


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As in a solve: threads of the linear algebra wait for each other in problems this small."""
    with threadpool_limits(1, "blas"):
        yield


def two_lamps(first: float, second: float) -> LitRoom:
    return light_room(*panels(*ENDS), {FIRST: first, SECOND: second}, clip=CLIP)


def radiance(room: LitRoom, lights: Lights) -> list[float]:
    """Of both lamps."""
    emission = lights.face_emission(len(room.room.regions)).mean(1)
    return [float(emission[room.faces(region)].mean()) for region in (FIRST, SECOND)]


def found(room: LitRoom) -> Lights:
    return find_lights(room.problem, room.observed, Progress())


def test_copies_with_different_bulbs_have_a_radiance_each_and_keep_it() -> None:
    room = two_lamps(14.0, 5.0)
    lights = found(room)
    assert radiance(room, lights) == pytest.approx([14.0, 5.0], rel=0.15)
    weight = patch_weight(room.problem, room.observed)
    again = reconsider_lamps(room.problem, room.observed, lights, weight, room.observed.radiance, Progress())
    assert radiance(room, again) == pytest.approx([14.0, 5.0], rel=0.15)
    back = Lights.from_arrays(lights.arrays())
    assert [faces.tolist() for faces in back.emitters_apart] == [faces.tolist() for faces in lights.emitters]


def test_copies_that_shine_alike_share_one_radiance() -> None:
    room = two_lamps(10.0, 10.0)
    lights = found(room)
    assert len(lights.emitters) == 2 and not lights.emitters_apart
    first, second = radiance(room, lights)
    assert first == second == pytest.approx(10.0, rel=0.15)
    (decision,) = [made for made in room.problem.decisions.report() if made["refinement"] == "unlike_copies"]
    assert not decision["accepted"]


def test_copies_that_one_light_state_tells_apart_are_apart_in_all() -> None:
    room = two_lamps(14.0, 5.0)
    lights = found(room)
    taken_for_one = room.solved(FIRST, SECOND)
    assert not taken_for_one.emitters_apart
    states = [LitState(room.problem, room.observed, own.emitters, own) for own in (taken_for_one, lights)]
    for solved in solve_states(states, Progress()):
        assert radiance(room, solved) == pytest.approx([14.0, 5.0], rel=0.15)
        assert len(solved.emitters_apart) == 2


def test_a_lamp_that_is_found_with_other_faces_stays_told_apart() -> None:
    """Another light state, or another round, finds some faces more or less, or both copies as one lamp."""
    lights = found(two_lamps(14.0, 5.0))
    first, second = lights.emitters
    apart = lights.apart_of([first[:1], np.array([10**6])])
    assert apart is not None and apart.tolist() == [True, False]
    both = replace(lights, emitters=[np.concatenate([first, second])], apart=None)
    assert both.apart_of([first, second]) is None
    told = both.told_apart(lights.emitters_apart).apart_of([first, second])
    assert told is not None and told.all()
