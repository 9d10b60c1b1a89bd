"""Which photo shows which light state, and the arrays of several states in one checkpoint."""

from __future__ import annotations

import numpy as np

from iris_addon.model.capture import Camera, View
from iris_addon.model.light_states import LightStates, joined_arrays, split_arrays


def views(*states: str) -> list[View]:
    camera = Camera(width=4, height=3, fx=4.0, fy=4.0, cx=2.0, cy=1.5, c2w=np.eye(4))
    return [View(f"{k:03d}", camera, None, light_state=state) for k, state in enumerate(states)]


def test_the_state_of_most_photos_comes_first_and_ties_follow_the_capture() -> None:
    states = LightStates.of(views("b", "a", "c", "a", "c"))
    assert states.names == ("a", "c", "b")
    assert states.index.tolist() == [2, 0, 1, 0, 1]
    assert states.photos(1).tolist() == [False, False, True, False, True]


def test_photos_that_name_no_state_are_of_one() -> None:
    states = LightStates.of(views("", "", ""))
    assert len(states) == 1
    assert not states.index.any()


def test_arrays_of_states_come_back_and_those_of_one_keep_their_names() -> None:
    each = [{"lights.radiance": np.full(3, float(k))} for k in range(12)]
    whole = {**joined_arrays(each), "gloss": np.ones(2)}
    assert whole["lights.radiance"][0] == 0
    back = split_arrays(whole, 12)
    assert [own["lights.radiance"][0] for own in back] == list(range(12))
    assert "gloss" in back[0]
    assert all(name == "lights.radiance" for own in back[1:] for name in own)
