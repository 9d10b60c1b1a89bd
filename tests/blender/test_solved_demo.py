"""The demo room that comes solved: opened, relit and rendered by a Blender without a solver."""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from iris_addon.capture.reader import read_capture
from iris_addon.evaluate.evaluation import evaluate
from iris_addon.results.folder import load_result
from tests.blender_home import ROOT, build_package, in_blender

pytestmark = [pytest.mark.bpy, pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")]

SOLVED, ROOM = ROOT / "assets" / "demo_solved", ROOT / "assets" / "demo_room"


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return build_package(tmp_path_factory.mktemp("package") / "iris.zip")


def test_it_is_a_solve_of_the_bundled_room_by_this_version():
    """Made anew by assets/make_solved_demo.py whenever the schema or the room changes."""
    result, capture = load_result(SOLVED), read_capture(ROOM)
    np.testing.assert_array_equal(result.mesh.faces, capture.mesh.faces)
    np.testing.assert_allclose(result.mesh.vertices, capture.mesh.vertices, atol=1e-6)
    checked = json.loads((SOLVED / "inspection" / "capture.json").read_text())
    assert [row["name"] for row in checked["views"]] == [view.name for view in capture.views]
    for row, view in zip(checked["views"], capture.views, strict=True):
        np.testing.assert_allclose(row["camera"]["c2w"], view.camera.c2w, atol=1e-9)
    scores = evaluate(result, ROOM, render=None)
    assert scores["emission_iou"] > 0.9 and scores["kd_psnr"] > 22


def test_from_installing_to_the_relit_room_without_a_solver(package, tmp_path):
    """Opened with one press from the start-up scene, in evening light with one more, and a picture."""
    picture = tmp_path / "evening.png"
    body = f"""
    from mathutils import Vector
    settings = scene.iris
    assert settings.open_data and not settings.open_solve
    assert not preferences.python and not bpy.ops.iris.import_demo.poll()
    assert bpy.ops.iris.open_demo() == {{"FINISHED"}}
    assert len(settings.views) == 28 and len(settings.lamps) == 3, len(settings.lamps)
    hidden = [thing for thing in scene.objects if thing.name in ("Cube", "Light")]
    assert hidden and all(thing.hide_render for thing in hidden)
    assert all(view.camera is not None for view in settings.views)
    images = [view.camera.data.background_images[0].image for view in settings.views]
    assert all(tuple(image.size) == (320, 240) for image in images)
    shown_kinds = sys.modules[KEY + ".operators.review"].shown_kinds
    view = next(area for area in bpy.context.screen.areas if area.type == "VIEW_3D")
    with bpy.context.temp_override(area=view):
        for kind in ("photo", "render", "error", "curve"):
            assert bpy.ops.iris.review(kind=kind) == {{"FINISHED"}}, kind
            if kind != "curve":
                assert shown_kinds(bpy.context) == {{kind}}, (kind, shown_kinds(bpy.context))
        spare = next(area for area in bpy.context.screen.areas if area.type == "DOPESHEET_EDITOR")
        spare.type = "IMAGE_EDITOR"
        bpy.ops.iris.review(kind="curve")
        assert shown_kinds(bpy.context) == {{"error", "curve"}}
        spare.type = "DOPESHEET_EDITOR"
        view.spaces.active.region_3d.view_perspective = "PERSP"
        assert shown_kinds(bpy.context) == set()
        bpy.ops.iris.review(kind="photo")  # looks through its camera
        assert shown_kinds(bpy.context) == {{"photo"}}
        settings.overlay = 0
        assert shown_kinds(bpy.context) == set()
    room = [thing for thing in scene.objects if thing.type == "MESH" and "iris_original" in thing]
    assert len(room) == 1

    icons = sys.modules[KEY + ".operators.ui.icons"]
    panels = sys.modules[KEY + ".operators.ui.panels"]
    loaded = len(icons._icons)
    shown = [panels.lamp_icon(lamp) for lamp in settings.lamps]
    assert len(icons._icons) == loaded + 3, "a picture for each lamp"
    assert [panels.lamp_icon(lamp) for lamp in settings.lamps] == shown and len(icons._icons) == loaded + 3
    sizes = {{tuple(picture.image_size) for key, picture in icons._icons.items() if "lamp-" in key}}
    assert sizes == {{(96, 96)}}, sizes
    assert icons.picture(home / "nothing.png") == 0
    wipe = sys.modules[KEY + ".operators.ui.wipe"]
    assert wipe.wiped_photo(scene) == images[settings.view_index] and settings.wipe == 0
    quad, uv, line = wipe.wiped([(10, 20), (110, 20), (110, 70), (10, 70)], 0.25)
    assert quad == [(10, 20), (35, 20), (35, 70), (10, 70)] and line == [(35, 20), (35, 70)]
    assert uv == [(0, 0), (0.25, 0), (0.25, 1), (0, 1)]
    line = sys.modules[KEY + ".operators.ui.wipe_line"]
    corners = [(10, 20), (110, 20), (110, 70), (10, 70)]
    assert [line.share_at(corners, x) for x in (35, 500, -500)] == [0.25, 1.0, line.LEAST_SHARE]
    near = [line.is_near(corners, 0.25, at, 8) for at in ((42, 40), (44, 40), (35, 19), (35, 71))]
    assert near == [True, False, False, False], near
    behind = scene.camera.data.background_images[0]
    behind.scale = 2  # it lies elsewhere then
    assert wipe.wiped_photo(scene) is None
    behind.scale = 1
    before = {{name: len(getattr(bpy.data, name)) for name in ("objects", "cameras", "collections")}}
    assert bpy.ops.iris.next_photos(on=True) == {{"FINISHED"}}
    suggested = list(bpy.data.collections["IRIS Next Photos"].objects)
    corners = [room[0].matrix_world @ Vector(corner) for corner in room[0].bound_box]
    for thing in suggested:
        for axis in range(3):
            assert min(c[axis] for c in corners) < thing.location[axis] < max(c[axis] for c in corners)
    assert 1 <= len(suggested) <= 5, suggested
    bpy.ops.iris.next_photos(on=False)
    assert before == {{name: len(getattr(bpy.data, name)) for name in before}}
    bpy.ops.iris.confidence(on=True)
    material = next(slot.material for slot in room[0].material_slots if slot.material.node_tree.nodes.active)
    image = material.node_tree.nodes.active.image
    assert image.name == "IRIS Confidence" and len({{round(v, 2) for v in image.pixels[:400000][::4]}}) > 8
    bpy.ops.iris.next_photos()
    bpy.ops.iris.confidence(on=False)

    day = [lamp for lamp in settings.lamps if lamp.area > 1]  # the window
    assert len(day) == 1
    day[0].on = False
    scene.render.resolution_percentage, scene.cycles.samples = 50, 16
    scene.render.filepath = {str(picture)!r}
    bpy.ops.render.render(write_still=True)

    sections = ("data", "check", "solve", "review", "relight", "insert", "export")
    unfolded = lambda: [name for name in sections if getattr(settings, f"open_{{name}}")]
    assert unfolded() == ["relight"]
    settings.open_insert = True
    settings.open_relight = False
    assert unfolded() == ["insert"]
    steps = sys.modules[KEY + ".operators.ui.steps"]
    assert steps.solved_line(Path(settings.result)).startswith("Solved: 3 lights in "), steps.solved_line(home)
    assert steps.solved_line(home) == "" and (steps.duration(52.3), steps.duration(180)) == ("52 s", "3 min")
    preferences.fold_steps = False
    assert unfolded() == [name for name in sections if name not in ("relight", "export")]
    preferences.fold_steps = True
    bpy.ops.iris.restore()
    assert before["cameras"] == len(bpy.data.cameras) and "IRIS Next Photos" not in bpy.data.collections
    assert unfolded() == ["review"]  # another step, another section
    bpy.ops.iris.apply()
    key = scene["iris_applied"]
    bpy.ops.iris.export(format="GLB", filepath={str(tmp_path / "room.glb")!r})
    assert bpy.ops.iris.open_demo() == {{"FINISHED"}} and scene["iris_applied"] == key
    assert len([thing for thing in bpy.data.objects if thing.type == "CAMERA" and "iris_view" in thing.data]) == 28
    shutil.copytree(settings.result, home / "another")
    settings.result = str(home / "another")
    bpy.ops.iris.apply()
    assert scene["iris_applied"] != key
    names = sorted(lamp.material.name for lamp in settings.lamps)
    assert names == ["IRIS Lamp 00", "IRIS Lamp 01", "IRIS Lamp 02"], names
    bpy.ops.iris.restore()
    """
    print(in_blender(package, tmp_path, body))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert picture.is_file() and (tmp_path / "room.glb").stat().st_size > 100_000
