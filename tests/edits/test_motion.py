"""Jobs and cameras in motion."""

import numpy as np
import pytest

from iris_addon.base.errors import BadInput
from iris_addon.edits.jobs import relight_edit
from iris_addon.edits.motion import at_time, camera_at
from tests.blender_room import camera, room

UP = (0.0, 0.0, 1.0)


def test_values_go_from_key_to_key():
    job = {
        "a": {"keys": [[0.2, 1.0], [0.6, 3.0]]},
        "b": [{"keys": [[0, [0, 1]], [1, [2, 3]]]}],
        "c": {"keys": [[0, True], [0.5, False]]},
    }
    assert at_time(job, 0.0) == {"a": 1.0, "b": [[0, 1]], "c": True}
    assert at_time(job, 0.4)["a"] == pytest.approx(2.0)
    assert at_time(job, 0.5) == {"a": pytest.approx(2.5), "b": [[1.0, 2.0]], "c": False}
    assert at_time(job, 1.0) == {"a": 3.0, "b": [[2, 3]], "c": False}
    for wrong in ([], [[0, 1, 2]], [[0.5, 1], [0.1, 2]], [[0, [1]], [1, [1, 2]]]):
        with pytest.raises(BadInput, match="keys"):
            at_time({"a": {"keys": wrong}}, 0.5)


def test_a_lamp_fades_in_time():
    lit = room(emission={4: (8, 8, 8)})
    job = {"recovered": {"0": {"scale": {"keys": [[0, 1], [1, 0]]}}}}
    assert relight_edit(lit, job, time=0.25).face_emission[8, 0] == pytest.approx(6.0)


def test_a_camera_path_starts_and_ends_at_its_views_and_turns_evenly():
    first, last = camera(position=(0, 0, 0)), camera(position=(2, 0, 0), fx=20.0)
    last.c2w[:3, :3] = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], float)  # a quarter turn
    for time, end in ((0.0, first), (1.0, last)):
        there = camera_at({"path": "all"}, [first, last], UP, time)
        np.testing.assert_allclose(there.c2w, end.c2w, atol=1e-12)
        assert there.fx == end.fx
    half = camera_at({"path": [0, 1]}, [first, last], UP, 0.5)
    np.testing.assert_allclose(half.position, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(half.c2w[:3, :3], np.array([[1, 0, 1], [0, 2**0.5, 0], [-1, 0, 1]]) / 2**0.5, atol=1e-12)
    # Half a turn has no shortest way; any will do as long as it arrives.
    last.c2w[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(camera_at({"path": "all"}, [first, last], UP, 1.0).c2w, last.c2w, atol=1e-12)


def test_an_orbit_keeps_what_the_camera_looks_at():
    view = camera(position=(0, 0, 3.0))
    center = np.array([0.0, 0.0, 0.5])
    for time in (0.0, 0.3, 1.0):
        moved = camera_at({"view": 0, "orbit": {"center": center.tolist()}}, [view], (0.0, 1.0, 0.0), time)
        assert np.linalg.norm(moved.position - center) == pytest.approx(2.5)
        np.testing.assert_allclose(moved.position - 2.5 * moved.c2w[:3, 2], center, atol=1e-12)


def test_wrong_moves_raise_bad_input():
    for move, names in (({"view": 3}, "view 3"), ({"path": []}, "empty"), ({"zoom": 1}, "'zoom'")):
        with pytest.raises(BadInput, match=names):
            camera_at(move, [camera()], UP, 0.0)
