"""An operator in steps: each tick of its timer goes on, Esc gives up, and whatever ends it leaves no timer behind."""

import sys

import pytest

from tests.blender_home import build_package, in_blender

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")]

SET_UP = """
from types import SimpleNamespace
modal_steps = sys.modules[f"{KEY}.operators.modal_steps"]
modal_steps.bpy = SimpleNamespace(app=SimpleNamespace(background=False), types=bpy.types)  # as with a window
modal_steps.STEP_SECONDS = 0.0

class Manager:
    def __init__(self):
        self.timers, self.handlers = [], []
    def event_timer_add(self, seconds, window):
        self.timers.append(object())
        return self.timers[-1]
    def event_timer_remove(self, timer):
        self.timers.remove(timer)
    def modal_handler_add(self, operator):
        self.handlers.append(operator)

class Seat:
    def __init__(self):
        self.window_manager, self.cursor, self.status = Manager(), "DEFAULT", None
        self.window = SimpleNamespace(cursor_modal_set=self.set, cursor_modal_restore=lambda: self.set("DEFAULT"))
        self.workspace = SimpleNamespace(status_text_set=self.say)
    def set(self, cursor):
        self.cursor = cursor
    def say(self, text):
        self.status = text
    def at_rest(self):
        return (self.window_manager.timers, self.cursor, self.status) == ([], "DEFAULT", None)

class Work(modal_steps.InSteps):
    bl_label = "Work"
    def __init__(self, end):
        self.end, self.done, self.told = end, [], []
    def report(self, kinds, text):
        self.told.append((*kinds, text))
    def steps(self, context):
        try:
            yield "one"
            self.done.append("one")
            yield "two"
            self.done.append("two")
            if isinstance(self.end, Exception):
                raise self.end
            return self.end
        except GeneratorExit:
            self.done.append("given up")
            raise

def event(kind):
    return SimpleNamespace(type=kind)
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """The built extension."""
    return build_package(tmp_path_factory.mktemp("package") / "iris.zip")


def test_an_operator_in_steps_ends_as_its_work_does(package, tmp_path):
    body = (
        SET_UP
        + """
BadInput = sys.modules[f"{KEY}.iris_addon.base.errors"].BadInput

seat, work = Seat(), Work({"FINISHED"})
assert work.invoke(seat, event("LEFTMOUSE")) == {"RUNNING_MODAL"} and modal_steps.busy() and seat.cursor == "WAIT"
other = Work({"FINISHED"})
assert other.invoke(seat, event("LEFTMOUSE")) == {"CANCELLED"} and "busy" in other.told[0][1]
assert len(seat.window_manager.timers) == 1 and modal_steps.busy()
# The mouse reaches the rest of Blender; keys that could change the scene do not.
assert work.modal(seat, event("MOUSEMOVE")) == {"PASS_THROUGH"} and work.modal(seat, event("X")) == {"RUNNING_MODAL"}
assert work.done == []
assert work.modal(seat, event("TIMER")) == {"RUNNING_MODAL"} and "Work: one" in seat.status
assert work.modal(seat, event("TIMER")) == {"RUNNING_MODAL"} and "Work: two" in seat.status and work.done == ["one"]
assert work.modal(seat, event("TIMER")) == {"FINISHED"} and work.done == ["one", "two"]
assert seat.at_rest() and not modal_steps.busy() and work.told == []

given_up = Work({"FINISHED"})
given_up.invoke(seat, event("LEFTMOUSE"))
given_up.modal(seat, event("TIMER"))
assert given_up.modal(seat, event("ESC")) == {"CANCELLED"} and given_up.done == ["given up"]
assert seat.at_rest() and not modal_steps.busy() and given_up.told[0][0] == "INFO"

for error, words in ((BadInput("is damaged", "restore it"), "is damaged"), (ReferenceError("removed"), "is gone")):
    refused = Work(error)
    refused.invoke(seat, event("LEFTMOUSE"))
    ends = [refused.modal(seat, event("TIMER")) for _ in range(3)]
    assert ends == [{"RUNNING_MODAL"}, {"RUNNING_MODAL"}, {"CANCELLED"}]
    assert refused.told[0][0] == "ERROR" and words in refused.told[0][1] and seat.at_rest() and not modal_steps.busy()

broken = Work(ZeroDivisionError())
broken.invoke(seat, event("LEFTMOUSE"))
try:
    for _ in range(3):
        broken.modal(seat, event("TIMER"))
    raise AssertionError("a fault of the program was hidden")
except ZeroDivisionError:
    assert seat.at_rest() and not modal_steps.busy()

# One that goes on by itself, as Place does once it has read the room, keeps nobody else from working.
dragging = Work({"RUNNING_MODAL"})
dragging.invoke(seat, event("LEFTMOUSE"))
assert [dragging.modal(seat, event("TIMER")) for _ in range(3)][-1] == {"RUNNING_MODAL"}
assert seat.at_rest() and not modal_steps.busy()
following = Work({"FINISHED"})
assert following.invoke(seat, event("LEFTMOUSE")) == {"RUNNING_MODAL"}
dragging.cancel(seat)
assert modal_steps.busy()  # by the other, whose work is not done
following.cancel(seat)
assert not modal_steps.busy() and seat.window_manager.timers == []
"""
    )
    in_blender(package, tmp_path, body)
