"""Work in steps has the result of work at once, hears questions from its thread, and given up leaves nothing behind."""

import threading
from dataclasses import replace
from itertools import count

import bpy
import numpy as np
import pytest

from iris_addon.base.errors import BadInput, Cancelled
from iris_addon.blender.apply import on_objects
from iris_addon.blender.apply.on_objects import apply_steps, apply_to_objects
from iris_addon.blender.stepwise import advance, finish, in_thread, in_thread_asking
from tests.scene_snapshot import snapshot
from tests.solved_scene import cube, solve


def test_work_in_a_thread_returns_what_it_made_and_lets_others_go_on_meanwhile():
    go_on = threading.Event()

    def work() -> int:
        assert go_on.wait(10)
        return threading.get_ident()

    steps = in_thread(work, "waiting")
    assert [next(steps) for _ in range(3)] == ["waiting"] * 3
    go_on.set()
    assert finish(steps) != threading.get_ident()


def test_an_exception_in_a_thread_is_raised_where_the_steps_are_taken():
    def work() -> None:
        raise BadInput("is damaged", "restore it")

    with pytest.raises(BadInput, match="is damaged"):
        finish(in_thread(work, "reading"))


def test_questions_are_answered_by_the_thread_that_takes_the_steps():
    def answer(question: int) -> tuple[int, int]:
        return question, threading.get_ident()

    def work(ask) -> list[tuple[int, int]]:
        return [ask(1), ask(2)]

    assert finish(in_thread_asking(work, answer, "reading")) == [(k, threading.get_ident()) for k in (1, 2)]


def test_a_question_that_cannot_be_answered_fails_where_it_was_asked():
    def answer(_question: int) -> None:
        raise BadInput("no such picture", "restore it")

    def work(ask) -> str:
        try:
            ask(1)
        except BadInput as error:
            return error.what
        return ""

    assert finish(in_thread_asking(work, answer, "reading")) == "no such picture"


def test_a_thread_whose_steps_are_given_up_ends_with_its_next_question():
    ended, asked = threading.Event(), threading.Event()

    def work(ask) -> None:
        asked.wait(10)
        try:
            ask(1)
        except Cancelled:
            ended.set()

    steps = in_thread_asking(work, lambda question: question, "reading")
    next(steps)
    steps.close()
    asked.set()
    assert ended.wait(10)


def test_steps_are_taken_until_their_time_is_up_and_one_at_least():
    def steps():
        yield from map(str, range(3))
        return "result"

    taken = steps()
    assert advance(taken, 0.0) == "0"
    with pytest.raises(StopIteration) as end:
        advance(taken, 60.0)
    assert end.value.value == "result"


@pytest.fixture
def room_with_backdrop():
    """Objects that keep their polygons and one that cannot, and a result for them, with small textures."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    cube("plain")
    cube("modified", None, location=(0, 0, 5)).modifiers.new("copies", "ARRAY").count = 2
    return solve(lamp_faces=[0, 3])


@pytest.mark.bpy
@pytest.mark.parametrize("applied", [False, True])
def test_a_result_that_is_given_up_at_any_step_changes_nothing(room_with_backdrop, applied: bool):
    result, runs = room_with_backdrop
    scene = bpy.context.scene
    if applied:
        apply_to_objects(result, runs, scene, "earlier")
    before = snapshot(scene)
    other = replace(result, emitters=tuple(replace(e, radiance=np.ones(3)) for e in result.emitters))
    for number in count(1):
        steps = apply_steps(other, runs, scene, "later")
        try:
            for _ in range(number):
                next(steps)
        except StopIteration as end:
            assert end.value
            break
        meanwhile = snapshot(scene)
        assert all(meanwhile[part] == before[part] for part in before if part not in ("blocks", "meshes")), number
        steps.close()
        assert snapshot(scene) == before, number
    assert number > 8
    apply_to_objects(result, runs, scene, "again")
    lamp = next(slot.material for slot in scene.objects["plain"].material_slots if "Lamp" in slot.material.name)
    assert lamp.name == "IRIS Lamp 07"


@pytest.mark.bpy
@pytest.mark.parametrize("part", ["_keep_object", "make_world", "add_sun", "show_like_the_photos", "keep_light_states"])
def test_a_result_that_fails_halfway_through_the_last_step_is_taken_off_again(
    room_with_backdrop, part: str, monkeypatch: pytest.MonkeyPatch
):
    result, runs = room_with_backdrop
    scene = bpy.context.scene
    before = snapshot(scene)

    def fail(*_arguments: object) -> None:
        raise MemoryError

    monkeypatch.setattr(on_objects, part, fail)
    with pytest.raises(MemoryError):
        apply_to_objects(result, runs, scene, "key")
    assert snapshot(scene) == before
    monkeypatch.undo()
    assert apply_to_objects(result, runs, scene, "key")
