"""What the sidebar lists and draws, in the packaged extension on the bundled room; panels draw into a layout that notes
what they draw."""

import sys
from pathlib import Path

import pytest

from tests.blender_home import build_package, in_blender

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")]

SET_UP = """
from types import SimpleNamespace
import numpy as np

class Layout:
    def __init__(self, drawn):
        self.__dict__["drawn"] = drawn

    def __setattr__(self, name, value):
        pass

    def row(self, **_):
        return self
    column = split = box = grid_flow = row

    def panel(self, *_, **__):
        return self, self
    panel_prop = panel

    def operator(self, name, **words):
        self.drawn.append((name, words.get("text")))
        return SimpleNamespace()

    def prop(self, _data, name, **words):
        self.drawn.append((name, words.get("text")))

    def label(self, **words):
        self.drawn.append(("label", words.get("text")))

    def template_list(self, kind, *_, **__):
        self.drawn.append((kind, None))

    def template_icon(self, *_, **__):
        pass

def module(name):
    return sys.modules[f"{KEY}.operators.{name}"]

def drawn(panel):
    found = []
    space = SimpleNamespace(shading=SimpleNamespace(type="SOLID"))
    sizes = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))  # 0 in background
    context = SimpleNamespace(scene=scene, space_data=space, screen={}, region=None, preferences=sizes)
    getattr(module("ui.panels"), panel).draw_section(None, Layout(found), context)
    return found

def listed(kind, what, **words):
    flags, order = kind.filter_items(SimpleNamespace(bitflag_filter_item=1 << 30, **words), bpy.context, settings, what)
    return [flag == 1 << 30 for flag in flags], list(order)

assert bpy.ops.iris.open_demo() == {"FINISHED"}
settings = scene.iris
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return build_package(tmp_path_factory.mktemp("package") / "iris.zip")


def test_what_undoes_a_result_is_drawn_also_without_its_folder(package, tmp_path):
    in_blender(
        package,
        tmp_path,
        SET_UP
        + """
there = drawn("IRIS_PT_review")
out = module("folders").folder(scene)
assert home in out.parents and out.is_dir()
shutil.rmtree(out)
gone = drawn("IRIS_PT_review")
assert ("label", "No result yet") in gone and ("iris.apply", None) not in gone, gone
for name in ("iris.restore", "iris.confidence"):
    assert [row for row in gone if row[0] == name] == [row for row in there if row[0] == name] != [], (name, gone)
assert "iris.match_photo" in dict(drawn("IRIS_PT_relight"))
bpy.ops.iris.restore()
assert not {"iris.restore", "iris.confidence"} & set(dict(drawn("IRIS_PT_review")))
""",
    )


def test_lamps_of_low_confidence_are_folded_and_looks_have_buttons(package, tmp_path):
    in_blender(
        package,
        tmp_path,
        SET_UP
        + """
kind = module("ui.panels").IRIS_UL_lamps
for lamp, confidence in zip(settings.lamps, (0.9, 0.05, 0.3)):
    lamp.confidence = confidence
assert len(settings.lamps) == 3
assert listed(kind, "lamps")[0] == [True, False, True]
assert ("show_unsure", "Show 1 Unsure Lamps") in drawn("IRIS_PT_relight")
settings.show_unsure = True
assert listed(kind, "lamps")[0] == [True, True, True]
settings.show_unsure = False
for lamp in settings.lamps:
    lamp.confidence = 0.05
assert listed(kind, "lamps")[0] == [True, True, True]  # an empty list would hide that there are lamps
for lamp in settings.lamps:
    lamp.confidence = 0.9
relight = drawn("IRIS_PT_relight")
assert "show_unsure" not in dict(relight) and ("watts", "") in relight
bpy.ops.iris.save_look(name="Dim")
assert ("iris.own_look", "Dim") in drawn("IRIS_PT_relight")
del scene["iris_own_looks"]
assert ("iris.own_look", "Dim") in drawn("IRIS_PT_relight")  # the preset
bpy.ops.iris.forget_look(name="Dim")
assert "iris.own_look" not in dict(drawn("IRIS_PT_relight"))
""",
    )


def test_photos_are_sorted_and_filtered(package, tmp_path):
    in_blender(
        package,
        tmp_path,
        SET_UP
        + """
kind = module("ui.photo_list").IRIS_UL_views
while len(settings.views) > 3:
    settings.views.remove(3)
rows = (("left", 0.9, 0.0, ""), ("middle", 0.1, 0.2, "lies beside the mesh"), ("right", 0.5, 0.4, ""))
for view, (view.name, view.score, view.saturated, view.problem) in zip(settings.views, rows):
    pass
assert listed(kind, "views", filter_name="") == ([True] * 3, [])
settings.photo_order = "SCORE"
assert listed(kind, "views", filter_name="")[1] == [2, 0, 1]  # place of each in the list
settings.photo_order = "SATURATED"
assert listed(kind, "views", filter_name="")[1] == [2, 1, 0]
assert listed(kind, "views", filter_name="i")[0] == [False, True, True]
settings.problems_only = True
assert listed(kind, "views", filter_name="")[0] == [False, True, False]
assert listed(kind, "views", filter_name="right")[0] == [False] * 3
""",
    )


def test_a_click_on_a_lamp_shows_its_faces_for_a_moment(package, tmp_path):
    in_blender(
        package,
        tmp_path,
        SET_UP
        + """
shown, (first, second) = module("ui.lamp_highlight"), [lamp.material for lamp in settings.lamps][:2]
calls = []
module("ui.settings").highlight = lambda where, lamp: calls.append((where, lamp))
settings.lamp_index = 1
assert calls == [(scene, second)]
settings.lamp_index = 7
assert len(calls) == 1

room = settings.room
room.matrix_world = __import__("mathutils").Matrix(((0, -2, 0, 1), (2, 0, 0, 2), (0, 0, 2, 3), (0, 0, 0, 1)))
bpy.context.view_layer.update()
data = room.data
slot = data.materials.find(first.name)
corners = [room.matrix_world @ data.vertices[v].co for t in data.loop_triangles
           if t.material_index == slot for v in t.vertices]
assert len(corners) and max(v.z for v in corners) > 3
found = shown.lamp_triangles(scene, first)
assert sorted(map(tuple, np.round(found, 4).tolist())) == sorted(map(tuple, np.round(corners, 4).tolist()))
assert len(shown.lamp_triangles(scene, bpy.data.materials.new("no lamp"))) == 0

shown.highlight(scene, first)
assert shown._Shown.triangles is None  # in background there is nothing to draw on
timers = []
registry = SimpleNamespace(is_registered=lambda end: bool(timers),
                           register=lambda end, first_interval: timers.append((end, first_interval)))
shown.bpy = SimpleNamespace(app=SimpleNamespace(background=False, timers=registry), context=bpy.context)
shown.highlight(scene, first)
assert np.array_equal(shown._Shown.triangles, found) and timers == [(shown._end, shown.SECONDS)]
shown.highlight(scene, second)
assert len(timers) == 1 and np.array_equal(shown._Shown.triangles, shown.lamp_triangles(scene, second))
assert shown._end() > 0 and shown._Shown.triangles is not None  # the second lamp has its time
shown._Shown.until = 0
assert shown._end() is None and shown._Shown.triangles is None
""",
    )
