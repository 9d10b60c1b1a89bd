"""The lamps of a room from those that each light state was found to have."""

from __future__ import annotations

import numpy as np

from iris_addon.base.progress import Progress
from iris_addon.lighting.common_lamps import common_lamps
from iris_addon.lighting.lamp_radiance import LitState, solve_together
from tests.light_room import CEILING_LAMP, WALL_PANEL, light_room, panels

AREAS = np.ones(40)


def faces(first: int, last: int) -> np.ndarray:
    return np.arange(first, last, dtype=np.int64)


def test_a_lamp_of_two_states_is_one_lamp_and_one_of_a_single_state_is_off_elsewhere() -> None:
    lamps, on = common_lamps([[faces(0, 4), faces(10, 12)], [faces(0, 4)], []], AREAS)
    assert [lamp.tolist() for lamp in lamps] == [[0, 1, 2, 3], [10, 11]]
    assert on.tolist() == [[True, True], [True, False], [False, False]]


def test_the_faces_of_a_lamp_are_those_of_all_states() -> None:
    lamps, on = common_lamps([[faces(0, 5)], [faces(3, 8)], [faces(7, 8)]], AREAS)
    assert [lamp.tolist() for lamp in lamps] == [list(range(8))]
    assert on.all()


def test_two_lamps_that_one_state_shows_as_one_are_two_where_another_tells_them_apart() -> None:
    lamps, on = common_lamps([[faces(0, 8)], [faces(0, 4), faces(4, 8)]], AREAS)
    assert [lamp.tolist() for lamp in lamps] == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert on.all()


def test_a_lamp_of_which_a_state_lights_one_half_is_off_in_the_other_half() -> None:
    lamps, on = common_lamps([[faces(0, 4), faces(4, 8)], [faces(0, 4)]], AREAS)
    assert [lamp.tolist() for lamp in lamps] == [[0, 1, 2, 3], [4, 5, 6, 7]]
    assert on.tolist() == [[True, True], [True, False]]


def test_a_speck_that_a_state_finds_at_the_edge_of_an_unlit_lamp_does_not_light_it() -> None:
    lamps, on = common_lamps([[faces(0, 10), faces(10, 20)], [np.array([9, 10, 11, 12, 13, 14, 15], np.int64)]], AREAS)
    assert len(lamps) == 2
    assert on[1].tolist() == [False, True]


def test_a_room_without_lamps_has_none_in_any_state() -> None:
    lamps, on = common_lamps([[], []], AREAS)
    assert not lamps
    assert on.shape == (2, 0)


def test_a_state_in_which_every_named_lamp_is_dark_has_none_in_a_closed_room() -> None:
    """Its photos are lit by what nobody named; the lamp that the file of lamps gives must not stay on in it."""
    room = light_room(*panels(CEILING_LAMP, WALL_PANEL, albedo=0.85), {7: 6.0})
    named = room.lights({6: 4.0})
    (dark,) = solve_together([LitState(room.problem, room.observed, [], named)], Progress())
    assert not dark.emitters
    assert not dark.mask.any() and not len(dark.radiance)
    (lit,) = solve_together([LitState(room.problem, room.observed, [room.faces(7)], named)], Progress())
    assert room.lamps(lit) == {7}
