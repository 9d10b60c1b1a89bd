"""The extension: built, validated, installed into a Blender of its own, used from import to export, disabled."""

import ast
import json
import platform
import re
import sys
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iris_addon.capture.reader import read_capture
from iris_addon.model.recovered import LightState
from iris_addon.model.response import gamma
from iris_addon.results.folder import save_result
from tests.blender_home import ROOT, blender_ext, build_package, fake_solver, in_blender
from tests.blender_room import box, room
from tests.box_room import RoomCapture, box_mesh, write_mesh
from tests.colmap_model import camera_of, poses, write_binary

pytestmark = [
    pytest.mark.bpy,
    pytest.mark.skipif(sys.platform == "win32", reason="the stand-in solver is a script with a #! line"),
]

ALLOWED_OPS = (
    "render.",
    "object.bake",
    "wm.open_mainfile",
    "wm.window_new",
    "import_scene.",
    "export_scene.",
    "scene.view_layer_remove_lightgroup",
    "wm.usd_",
    "wm.obj_",
    "wm.ply_",
    "iris.",
)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return build_package(tmp_path_factory.mktemp("package") / "iris.zip")


@pytest.fixture
def solved(tmp_path) -> Path:
    """A result for the box capture."""
    mesh = replace(box_mesh(), uv=box().uv)
    save_result(room(mesh=mesh, emission={3: (12, 10, 8)}), tmp_path / "solved")
    return tmp_path / "solved"


@pytest.fixture
def worker(tmp_path, solved) -> Path:
    """Reads captures as the real solver does, and has every solve ready."""
    return fake_solver(
        tmp_path,
        f"""
        command = sys.argv[sys.argv.index("-B") + 2]
        if command == "inspect":
            os.execv({sys.executable!r}, [{sys.executable!r}, *sys.argv[1:]])
        out = sys.argv[sys.argv.index("--out") + 1]
        print(json.dumps(dict(type="progress", stage="x", fraction=1, overall=1, seconds_left=0, message="")))
        shutil.copytree({str(solved)!r}, out, dirs_exist_ok=True)
        report = json.load(open(out + "/report.json"))
        if "--exclude" in sys.argv:
            words = sys.argv[sys.argv.index("--exclude") + 1:]
            report["excluded"] = words[: next(k for k, word in enumerate(words) if word.startswith("--"))]
        json.dump(report, open(out + "/report.json", "w"))
        open(os.path.join(out, "asked.txt"), "w").write(" ".join(sys.argv))
        print(json.dumps(dict(type="done", result={{}})))
        """,
    )


# ---- the package ---------------------------------------------------------------------------------------------------


def test_the_package_is_valid_and_has_nothing_else_in_it(package):
    checked = blender_ext("validate", str(package))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    names = zipfile.ZipFile(package).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {"blender_manifest.toml", "__init__.py", "iris_addon", "operators", "headless"} <= tops
    assert not tops & {"tests", "benchmarks", "docs", "out", "dist", "pyproject.toml", ".ci", ".venv"}
    assert not [name for name in names if "__pycache__" in name or "/gt/" in name]
    demo = [name for name in names if name.startswith("assets/")]
    assert "assets/demo_room/scene.ply" in demo and "assets/demo_room/train/transforms.json" in demo
    assert all(name.startswith(("assets/demo_room/", "assets/demo_solved/")) for name in demo if not name.endswith("/"))
    assert package.stat().st_size < 6_000_000


def test_what_is_downloaded_is_what_is_pinned():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pinned, extras = project["dependencies"], project["optional-dependencies"]
    optional = (ROOT / "headless" / "optional_requirements.txt").read_text().splitlines()
    named = [line.partition(";")[0] for line in optional if not line.startswith("#")]
    assert named == [*extras["formats"], *extras["cuda"]]
    locked = (ROOT / "headless" / "optional_lock.txt").read_text().lower()
    assert all(f"\n{pin.lower()} " in locked for pin in named)
    lines = (ROOT / "headless" / "solver_requirements.txt").read_text().splitlines()
    assert [line for line in lines if not line.startswith("#")] == [p for p in pinned if not p.startswith("bpy")]


def test_what_is_locked_is_what_is_pinned_and_every_file_has_a_hash():
    lock = (ROOT / "headless" / "solver_lock.txt").read_text()
    entries = re.findall(r"^(\S+==\S+)(?: ; (.*?))? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", lock, re.M)
    assert sum(len(hashes.splitlines()) + 1 for _, _, hashes in entries) + 1 == len(lock.splitlines())
    locked = {pin.lower() for pin, _, _ in entries}
    lines = (ROOT / "headless" / "solver_requirements.txt").read_text().splitlines()
    assert {line.partition(";")[0].strip().lower() for line in lines if not line.startswith("#")} <= locked
    assert "://" not in lock  # whoever installs it has an index of their own


def test_no_operator_of_blender_is_called_beyond_what_files_and_renders_need():
    for path in [*(ROOT / "operators").rglob("*.py"), *(ROOT / "iris_addon").rglob("*.py")]:
        for line in path.read_text(encoding="utf-8").splitlines():
            for call in line.split("bpy.ops.")[1:]:
                assert call.startswith(ALLOWED_OPS), f"{path}: {line.strip()}"


# ---- on and off ----------------------------------------------------------------------------------------------------


def test_enabling_and_disabling_leaves_no_trace(package, tmp_path):
    in_blender(
        package,
        tmp_path,
        """
        def traces():
            types = {name for name in dir(bpy.types) if "IRIS" in name.upper() and name != "ShaderFxIris"}
            handlers = [len(getattr(bpy.app.handlers, n)) for n in dir(bpy.app.handlers) if n[0] != "_"
                        and isinstance(getattr(bpy.app.handlers, n), list)]
            places = ("TOPBAR_MT_file_import", "TOPBAR_MT_file_export", "VIEW3D_MT_object", "STATUSBAR_HT_header")
            menu = sum(len(getattr(bpy.types, place)._dyn_ui_initialize()) for place in places)
            scene = hasattr(bpy.types.Scene, "iris") or hasattr(bpy.types.Camera, "iris_exposure")
            return types, handlers, menu, scene, dir(bpy.ops.iris)

        on = traces()
        bpy.ops.preferences.addon_disable(module=KEY)
        off = traces()
        assert not off[0] and not off[3] and not off[4], off
        assert on[2] == off[2] + 4 and on[1] == off[1]
        for _ in range(2):
            bpy.ops.preferences.addon_enable(module=KEY)
            assert traces() == on
            bpy.ops.preferences.addon_disable(module=KEY)
            assert traces() == off
        """,
    )


def test_every_operator_of_an_artist_stands_in_a_menu():
    """The search (F3) finds what menus have."""
    texts = [path.read_text() for path in (ROOT / "operators").rglob("*.py")]
    every = {name for text in texts for name in re.findall(r'bl_idname = "(iris\.\w+)"', text)}
    menus = set(re.findall(r'"(iris\.\w+)"', (ROOT / "operators" / "menus.py").read_text()))
    of_panels = {
        "cancel",
        "copy_error",
        "show_log",
        "add_capture",
        "step_photo",
        "next_problem",
        "review",
        "own_look",
        "forget_look",
        "forget_scale",
    }
    of_preferences = {"test_python", "make_environment"}
    assert every - menus == {f"iris.{name}" for name in of_panels | of_preferences}


def test_every_setting_says_what_it_is(package, tmp_path):
    """A tooltip for each property of a scene, and for each choice of those that have choices."""
    in_blender(
        package,
        tmp_path,
        """
        settings = sys.modules[KEY + ".operators.ui.settings"]
        groups = [thing for name, thing in vars(settings).items() if name.startswith("Iris")]
        assert len(groups) == 3, groups
        for group in groups:
            for name in group.__annotations__:
                found = group.bl_rna.properties[name]
                assert found.name and found.name != name and len(found.description) > 8, (group, name)
                items = found.enum_items if found.type == "ENUM" else ()
                assert all(item.description for item in items), (group, name)
        """,
    )


# ---- in use --------------------------------------------------------------------------------------------------------


def test_from_capture_to_files_and_back(package, tmp_path, worker, nerfstudio_room: RoomCapture):
    """Import, check, solve, review, apply, undo, apply, relight, export, save, restore; in a Blender without torch."""
    body = f"""
    preferences.python = {str(worker)!r}
    settings = scene.iris
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root / "transforms.json")!r})
    assert [view.verdict for view in settings.views].count("shifted") == 0
    assert len(settings.views) == 6 and scene.camera == settings.views[0].camera
    assert all(len(view.camera.data.background_images) == 1 for view in settings.views)
    assert len(settings.room.data.polygons) == 12 and settings.room.matrix_world.is_identity
    for expected in (1, 2):
        bpy.ops.iris.step_photo(by=1)
        assert settings.view_index == expected and scene.camera == settings.views[expected].camera
    blocks = len(bpy.data.objects)
    bpy.ops.iris.check()
    assert len(bpy.data.objects) == blocks and len(settings.views) == 6

    settings.views[2].use = settings.views[4].use = False
    bpy.ops.iris.check()
    assert [view.use for view in settings.views] == [True, True, False, True, False, True]  # as before

    assert not bpy.ops.iris.apply.poll()
    steps = sys.modules[KEY + ".operators.ui.steps"]
    folder = sys.modules[KEY + ".operators.folders"].folder(scene)
    assert steps.textures_line(settings) == "Textures: up to 2048 x 2048, 0.1 GB"
    settings.atlas_size, settings.texels_per_metre = "8192", 150
    assert steps.textures_line(settings) == "Textures: up to 8192 x 8192, 1.9 GB"
    bpy.ops.iris.solve()
    assert " --atlas-size 8192 --texels-per-metre 150 " in (folder / "asked.txt").read_text()
    assert steps.atlas_line(folder) == ""  # a result of an older version
    report = json.loads((folder / "report.json").read_text())
    report["atlas"] = dict(side=1024, texels_per_metre=57.6, bytes_in_blender=29360128)
    (folder / "report.json").write_text(json.dumps(report))
    assert steps.atlas_line(folder) == "1024 x 1024, 29 MB, 58 texels/m"
    settings.atlas_size, settings.texels_per_metre = "auto", 0
    assert steps.solve_step(scene).state == "done"
    settings.views[2].use = True
    assert steps.solve_step(scene).state == "stale"
    settings.views[2].use = False
    settings.views[5].problem = "it lies beside the mesh"
    bpy.ops.iris.next_problem()
    assert settings.view_index == 5 and scene.camera == settings.views[5].camera
    bpy.ops.iris.step_photo(by=3)
    bpy.ops.ed.undo_push(message="before the curve")
    bpy.ops.iris.review(kind="curve")
    assert tuple(bpy.data.images["IRIS Response"].size) == (256, 256)
    bpy.ops.ed.undo_push(message="the curve")
    bpy.ops.ed.undo()
    assert "IRIS Response" not in bpy.data.images
    bpy.ops.ed.redo()
    assert max(bpy.data.images["IRIS Response"].pixels[0:1024]) > 0.5  # not a black one

    settings = bpy.context.scene.iris
    behind = settings.views[0].camera.data.background_images[0]
    settings.overlay = 0.0
    bpy.ops.iris.step_photo(by=0)
    assert settings.overlay == behind.alpha == 0.5

    plain = settings.room.data.name
    bpy.ops.iris.apply()
    bpy.ops.ed.undo_push(message="applied")
    settings = bpy.context.scene.iris
    assert settings.room.data.name != plain and len(settings.lamps) == 1
    assert settings.lamps[0].strength == 12 and settings.lamps[0].area == 4
    assert settings.overlay == settings.views[0].camera.data.background_images[0].alpha == 0.0  # it would hide the room
    materials = len(bpy.data.materials)
    bpy.ops.iris.apply()
    assert len(bpy.data.materials) == materials and len(bpy.context.scene.iris.lamps) == 1
    bpy.ops.ed.undo()
    settings = bpy.context.scene.iris
    assert settings.room.data.name == plain and not settings.lamps and "IRIS Surface" not in bpy.data.materials
    assert "iris_applied" not in bpy.context.scene

    bpy.ops.iris.apply()
    lamp = bpy.context.scene.iris.lamps[0]
    lamp.on = False
    assert lamp.material.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value == 0
    lamp.on, lamp.strength = True, 5
    assert lamp.material.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value == 5
    bpy.ops.iris.export(format="GLB", filepath=str(home / "room.glb"))
    bpy.ops.iris.export(format="BLEND", filepath=str(home / "room.blend"))
    bpy.ops.iris.export(format="TEXTURES", filepath=str(home / "textures"))
    bpy.ops.iris.export_ies(directory=str(home / "lamps"))
    assert len(list((home / "lamps").glob("*.ies"))) == 1
    bpy.ops.iris.export(format="BLEND", filepath=str(home / "room.v2"))
    assert all((home / name).is_file() for name in ("room.glb", "room.blend", "room.v2.blend"))
    fails(bpy.ops.iris.export, "no file is named", format="GLB")
    assert (home / "textures" / "base_color.exr").is_file()

    bpy.ops.wm.save_as_mainfile(filepath=str(home / "mine.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(home / "mine.blend"))
    scene = bpy.context.scene
    assert scene.iris.lamps[0].strength == 5 and len(scene.iris.views) == 6
    bpy.context.view_layer.objects.active = scene.iris.room
    bpy.ops.object.mode_set(mode="EDIT")
    fails(bpy.ops.iris.restore, "leave edit mode")
    assert len(scene.iris.lamps) == 1
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.iris.restore()
    assert scene.iris.room.data.name == plain and not scene.iris.lamps
    """
    said = in_blender(package, tmp_path, body)
    assert "Traceback" not in said
    assert not [line for line in said.splitlines() if "Warning: " in line or "rna_uiItemO" in line]


def test_what_is_shown_takes_no_editor_that_an_artist_works_with(package, tmp_path, solved, nerfstudio_room):
    """Response, Mix Lights and Log in Blender's own layout, and beside an editor that may be changed."""
    (solved / "inspection").mkdir()
    in_blender(
        package,
        tmp_path,
        f"""
        from importlib import import_module
        from types import SimpleNamespace as N
        editors = import_module(KEY + ".operators.editors")
        bpy.context.scene.iris.result = {str(solved)!r}
        layout = lambda: sorted(area.type for area in bpy.context.screen.areas)
        before = layout()
        assert before == ["DOPESHEET_EDITOR", "OUTLINER", "PROPERTIES", "VIEW_3D"], before
        assert bpy.ops.iris.review(kind="curve") == {{"FINISHED"}}
        assert bpy.ops.iris.show_log(job="solve") == {{"FINISHED"}}
        editors.show_in_editor(bpy.context, "NODE_EDITOR", "tree_type", "CompositorNodeTree")  # as Mix Lights does
        assert layout() == before, layout()

        spare = next(area for area in bpy.context.screen.areas if area.type == "DOPESHEET_EDITOR")
        spare.type = "INFO"  # nobody works in it
        assert bpy.ops.iris.show_log(job="solve") == {{"FINISHED"}}
        assert spare.type == "TEXT_EDITOR" and spare.spaces.active.text.name == "IRIS solve log"
        assert bpy.ops.iris.review(kind="curve") == {{"FINISHED"}}
        assert spare.type == "IMAGE_EDITOR" and spare.spaces.active.image.name == "IRIS Response"
        assert layout() == ["IMAGE_EDITOR", "OUTLINER", "PROPERTIES", "VIEW_3D"], layout()
        """,
    )


def test_captures_are_imported_by_menu_and_by_drag_and_drop(package, tmp_path, worker, nerfstudio_room):
    """What Blender does with File > Import and with a file dropped into the 3D view, but for the mouse."""
    in_blender(
        package,
        tmp_path,
        f"""
        from types import SimpleNamespace as N
        handler = bpy.types.FileHandler.bl_rna_get_subclass_py("IRIS_FH_capture")
        over = lambda area: handler.poll_drop(N(area=area))
        assert over(N(type="VIEW_3D")) and not over(N(type="IMAGE_EDITOR")) and not over(None)
        assert handler.bl_file_extensions == ".json;.bin;.sfm;.xml;.csv;.out"
        entries = []
        layout = N(operator=lambda name, text: entries.append(name))
        for draw in bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize():
            if draw.__module__.startswith(KEY):
                draw(N(layout=layout), None)
        assert entries == [handler.bl_import_operator] == ["iris.import_capture"]

        preferences.python = {str(worker)!r}
        dropped = {str(nerfstudio_room.root / "transforms.json")!r}
        assert bpy.ops.iris.import_capture("INVOKE_DEFAULT", filepath=dropped) == {{"FINISHED"}}
        assert len(scene.iris.views) == 6 and scene.iris.room is not None
        """,
    )


def test_a_colmap_model_is_imported_by_any_of_its_files(package, tmp_path, worker, nerfstudio_room):
    capture = read_capture(nerfstudio_room.root)
    model = nerfstudio_room.root / "sparse" / "0"
    model.mkdir(parents=True)
    write_binary(model, camera_of(capture), poses(capture))
    photos = nerfstudio_room.root / "images"
    photos.mkdir(exist_ok=True)
    for photo in nerfstudio_room.photos:
        photo.rename(photos / photo.name)
    nerfstudio_room.transforms.unlink()
    in_blender(
        package,
        tmp_path,
        f"""
        preferences.python = {str(worker)!r}
        assert bpy.ops.iris.import_capture(filepath={str(model / "images.bin")!r}) == {{"FINISHED"}}
        assert sorted(v.name for v in scene.iris.views) == {sorted(view.name for view in capture.views)!r}
        assert scene.iris.room is not None
        """,
    )


def test_the_panel_shows_the_newest_preview_of_the_solve(package, tmp_path):
    body = """
    from importlib import import_module
    preview = import_module(KEY + ".operators.ui.solve_preview")
    files = import_module(KEY + ".iris_addon.results.files")
    assert preview.picture(home, "albedo") is None
    def write(kind, ns, side):
        image = bpy.data.images.new("x", side, side)
        path = files.preview_path(home, kind)
        image.filepath_raw, image.file_format = str(path), "PNG"
        path.parent.mkdir(exist_ok=True)
        image.save()
        os.utime(path, ns=(ns, ns))
    write("albedo", 10**18, 8)
    write("light", 10**18, 16)
    sides = lambda kind: tuple(preview.picture(home, kind).image_size)
    assert sides("albedo") == (8, 8) and sides("light") == (16, 16) and sides("albedo") == (8, 8)
    write("albedo", 2 * 10**18, 32)
    assert sides("albedo") == (32, 32)  # the newest
    assert preview.picture(home, "error") is None
    """
    in_blender(package, tmp_path, body)


def test_a_scene_is_solved_on_its_own_objects(package, tmp_path, worker, nerfstudio_room):
    body = f"""
    preferences.python = {str(worker)!r}
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    for thing in list(scene.objects):
        if thing.name in ("Cube", "Light", "Camera"):
            bpy.data.objects.remove(thing)
    room = scene.iris.room
    was = [getattr(scene.iris, name) for name in ("source", "capture", "room", "result")]
    scene.render.resolution_x *= 2
    fails(bpy.ops.iris.use_scene, "another shape")
    assert [getattr(scene.iris, name) for name in ("source", "capture", "room", "result")] == was
    scene.render.resolution_x //= 2
    bpy.ops.iris.use_scene()
    assert scene.iris.source == "SCENE" and len(scene.iris.views) == 6
    assert (Path(scene.iris.result) / "capture" / "transforms.json").is_file()
    assert Path(scene.iris.result).is_relative_to(home)  # never into the extension's folder, nor beside the capture
    assert all(view.camera is not None for view in scene.iris.views)
    shown = [view.camera.data.background_images[0] for view in scene.iris.views]
    for behind in shown:
        behind.alpha = 0.375
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    assert {{behind.alpha for behind in shown}} == {{0.375}}  # they are the artist's
    assert len(scene.iris.lamps) == 1 and room.data.name.endswith("IRIS")
    # Solved again as it was, not in its new dress.
    written = (Path(scene.iris.result) / "capture" / "mesh.ply").read_bytes()
    bpy.ops.iris.solve()
    assert (Path(scene.iris.result) / "capture" / "mesh.ply").read_bytes() == written
    bpy.ops.iris.apply()
    bpy.ops.iris.restore()
    """
    in_blender(package, tmp_path, body)


def test_objects_are_placed_on_the_surface_pointed_at(package, tmp_path, worker, nerfstudio_room):
    """What a click does with the line of sight through it: to the floor, to a wall, in units of centimetres, beside."""
    body = f"""
    from mathutils import Vector
    preferences.python = {str(worker)!r}
    assert not bpy.ops.iris.place.poll()
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    bpy.data.objects.remove(scene.objects["Cube"])
    room = [thing for thing in scene.objects if thing.type == "MESH"]
    low = min((thing.matrix_world @ Vector(c) for thing in room for c in thing.bound_box), key=lambda c: c.z)
    high = max((thing.matrix_world @ Vector(c) for thing in room for c in thing.bound_box), key=lambda c: c.x)
    eye = sum((view.camera.matrix_world.translation for view in scene.iris.views), Vector()) / len(scene.iris.views)

    def place(direction, **settings):
        before = set(scene.objects)
        assert bpy.ops.iris.place(origin=eye, direction=direction, **settings) == {{"FINISHED"}}
        bpy.context.view_layer.update()
        return sorted(set(scene.objects) - before, key=lambda thing: thing.type)

    def extent(thing):
        corners = [thing.matrix_world @ Vector(corner) for corner in thing.bound_box]
        return [(min(c[k] for c in corners), max(c[k] for c in corners)) for k in range(3)]

    anchor, ball = place((0, 0, -1), thing="MIRROR")
    (x0, x1), (y0, y1), (z0, z1) = extent(ball)
    assert abs(z0 - low.z) < 1e-3 and abs(z1 - z0 - 0.3) < 1e-3, (z0, z1, low.z)
    assert abs((x0 + x1) / 2 - eye.x) < 1e-3 and abs((y0 + y1) / 2 - eye.y) < 1e-3
    anchor, box = place((1, 0, 0), thing="BOX", size=0.5)
    (x0, x1), _y, _z = extent(box)
    assert abs(x1 - high.x) < 1e-3 and abs(x1 - x0 - 0.15) < 1e-3, (x0, x1, high.x)  # its underside on the wall

    # The one that is selected is moved, with the size it has; what was put in first is stood upon as the room is.
    assert bpy.context.view_layer.objects.active == anchor and bpy.context.selected_objects == [anchor]
    assert place((0, 0, -1), thing="SELECTED") == []
    (_x, _y, (z0, z1)) = extent(box)
    assert abs(z0 - low.z - 0.3) < 2e-2 and abs(z1 - z0 - 0.15) < 1e-2, (z0, z1)
    count = len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials)
    fails(bpy.ops.iris.place, "there is no surface", thing="GREY", origin=(0, 0, 99), direction=(0, 0, 1))
    assert count == (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials))
    bpy.context.view_layer.objects.active = scene.iris.room
    fails(bpy.ops.iris.place, "is the room", thing="SELECTED", direction=(0, 0, 1))

    scene.unit_settings.scale_length = 0.01
    anchor, ball = place((0, 0, -1), thing="GREY")
    assert abs(extent(ball)[2][1] - extent(ball)[2][0] - 30) < 0.1
    """
    in_blender(package, tmp_path, body)


def test_a_photo_gets_what_was_added_under_the_lamps_of_its_light_state(
    package, tmp_path, solved, worker, nerfstudio_room
):
    dark, green, red = np.zeros(3), np.array([1.0, 12.0, 1.0]), np.array([12.0, 1.0, 1.0])
    states = (
        LightState("evening", (), np.array([green, dark])),
        LightState("night", (), np.array([dark, red])),
    )
    made = room(mesh=replace(box_mesh(), uv=box().uv), emission={3: green, 2: dark})
    save_result(replace(made, response=gamma(), light_states=states), solved)
    listed = nerfstudio_room.root / "transforms.json"
    content = json.loads(listed.read_text())
    for frame in content["frames"]:
        frame["light_state"] = "night"
    listed.write_text(json.dumps(content))
    body = f"""
    import numpy as np
    from mathutils import Vector
    preferences.python = {str(worker)!r}
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(scene.objects[name])
    view = scene.iris.views[scene.iris.view_index]
    assert view.camera.data.iris_light_state == "night"
    eye = view.camera.matrix_world
    bpy.ops.iris.place(thing="GREY", origin=eye.translation, direction=eye.to_3x3() @ Vector((0, 0, -1)))
    for state, channel in (("night", 0), ("evening", 1)):
        view.camera.data.iris_light_state = state
        assert bpy.ops.iris.onto_photo(samples=16) == {{"FINISHED"}}
        shown = view.camera.data.background_images
        width, height = shown[1].image.size
        picture = np.empty(4 * width * height, np.float32)
        shown[1].image.pixels.foreach_get(picture)
        ball = picture.reshape(height, width, 4)[height // 2, width // 2]
        assert ball[channel] > 1.2 * ball[1 - channel], (state, ball)
    view.camera.data.iris_light_state = "noon"
    fails(bpy.ops.iris.onto_photo, "was not solved in the light state 'noon'", samples=4)
    """
    in_blender(package, tmp_path, body)


def test_what_was_added_goes_onto_the_photo_and_lights_are_mixed(package, tmp_path, solved, worker, nerfstudio_room):
    save_result(
        replace(room(mesh=replace(box_mesh(), uv=box().uv), emission={3: (12, 10, 8)}), response=gamma()), solved
    )
    body = f"""
    import numpy as np
    from mathutils import Vector
    preferences.python = {str(worker)!r}
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    assert not bpy.ops.iris.onto_photo.poll() and not bpy.ops.iris.mix_lights.poll()
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    for name in ("Cube", "Light"):
        bpy.data.objects.remove(scene.objects[name])
    view = scene.iris.views[scene.iris.view_index]
    eye = view.camera.matrix_world
    bpy.ops.iris.place(thing="GREY", origin=eye.translation, direction=eye.to_3x3() @ Vector((0, 0, -1)))
    scene.iris.layers = scene.iris.acescg = True
    assert bpy.ops.iris.onto_photo(samples=4) == {{"FINISHED"}}
    scene.iris.layers = False
    written = Path({str(nerfstudio_room.root)!r} + "-iris") / "onto-photos" / f"{{view.name}}-layers.exr"
    headers = sys.modules[KEY + ".iris_addon.base.image_headers"]
    (part,) = headers.read_exr_parts(written)
    assert {{"R", "plate.G", "catcher.B", "object.A"}} <= set(part.channels) and part.width > 0, part
    assert bpy.ops.iris.export_camera(directory=str(home / "camera")) == {{"FINISHED"}}
    assert {{"camera.cube", "config.ocio"}} <= {{path.name for path in (home / "camera").iterdir()}}
    shown = view.camera.data.background_images
    assert len(shown) == 2 and shown[1].image.name == f"IRIS Onto {{view.name}}" and shown[1].image.has_data is not None
    photo = np.empty(4 * shown[0].image.size[0] * shown[0].image.size[1], np.float32)
    changed = photo.copy()
    shown[0].image.pixels.foreach_get(photo)
    shown[1].image.pixels.foreach_get(changed)
    assert 0.001 < (np.abs(changed - photo) > 0.05).mean() < 0.9
    out = Path({str(nerfstudio_room.root)!r} + "-iris")
    assert not list(out.glob("onto-photo.*")) and (out / "onto-photos").is_dir()
    at = scene.iris.view_index
    bpy.ops.iris.review(kind="photo")
    assert len(shown) == 1 and shown[0].show_background_image and scene.iris.view_index == at
    shown[0].image.pack()
    Path(bpy.path.abspath(shown[0].image.filepath)).unlink()
    assert bpy.ops.iris.onto_photo(samples=4) == {{"FINISHED"}}
    assert len(shown) == 2 and not list(out.glob("onto-photo.*"))

    # The same photo as a plate of two frames, the second in a movie clip that starts with the scene's frame 5.
    assert not bpy.ops.iris.onto_plate.poll()
    plate = Path({str(tmp_path)!r}) / "plate"
    plate.mkdir()
    for number in (1, 2):
        (plate / f"sh.{{number:04d}}.png").write_bytes(bytes(shown[0].image.packed_file.data))
    scene.camera = view.camera
    clip = bpy.data.movieclips.load(str(plate / "sh.0001.png"))
    clip.frame_start = scene.frame_start = 5
    scene.frame_end = 6
    behind = shown.new()
    behind.source, behind.clip = "MOVIE_CLIP", clip
    made = plate.with_name("made")
    scene.iris.layers = True
    assert bpy.ops.iris.onto_plate(directory=str(made), samples=4) == {{"FINISHED"}}
    assert sorted(path.name for path in (made / "layers").iterdir()) == ["frame_0005.exr", "frame_0006.exr"]
    scene.iris.layers = False
    assert sorted(path.name for path in made.glob("*.png")) == ["frame_0005.png", "frame_0006.png"]
    assert not list(out.glob("onto-plate*"))
    again = bpy.data.images.load(str(made / "frame_0006.png"))
    again.pixels.foreach_get(changed)
    assert 0.001 < (np.abs(changed - photo) > 0.05).mean() < 0.9
    (plate / "sh.0002.png").unlink()
    fails(bpy.ops.iris.onto_plate, "1 of 2 frames failed (6)", directory=str(made), samples=4)
    assert bpy.ops.iris.onto_plate(directory=str(made), samples=4, resume=True) == {{"FINISHED"}}
    shown.remove(behind)

    bpy.ops.iris.match_photo(on=True)
    assert bpy.ops.iris.mix_lights(on=True) == {{"FINISHED"}}
    assert "IRIS Lamp 00" in scene.objects and "iris_matched" in scene and "iris_mixed" in scene
    tree = scene.node_tree if bpy.app.version < (5, 0, 0) else scene.compositing_node_group
    assert {{"IRIS Lights", "IRIS Camera"}} <= {{node.name for node in tree.nodes}}
    bpy.ops.iris.mix_lights(on=False)
    assert "IRIS Lamp 00" not in scene.objects and "iris_matched" in scene and "iris_mixed" not in scene
    bpy.ops.iris.match_photo(on=False)
    assert not scene.get("iris_matched")
    """
    in_blender(package, tmp_path, body)


def test_checking_again_imports_changes_of_the_capture(package, tmp_path, worker, nerfstudio_room):
    """Poses, lenses and mesh onto the objects that are there; what is no capture takes nothing away."""
    higher = tmp_path / "higher.ply"
    mesh = box_mesh()
    write_mesh(higher, replace(mesh, vertices=mesh.vertices * [1.0, 1.0, 1.01]))
    body = f"""
    import json
    preferences.python = {str(worker)!r}
    capture = Path({str(nerfstudio_room.root)!r})
    bpy.ops.iris.import_capture(filepath=str(capture))
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    count, room = len(scene.objects), scene.iris.room
    first = scene.iris.views[0].camera
    (home / "other.json").write_text("{{}}")
    fails(bpy.ops.iris.import_capture, "", filepath=str(home / "other.json"))
    assert scene.iris.room == room and len(scene.iris.views) == 6 and "iris_applied" in scene
    bpy.ops.iris.import_capture(filepath=str(capture))
    assert len(scene.objects) == count and scene.iris.room == room and "iris_applied" in scene

    poses = json.loads((capture / "transforms.json").read_text())
    for frame in poses["frames"]:
        frame["transform_matrix"][0][3] += 0.1
    before = first.matrix_world.translation.copy()
    (capture / "transforms.json").write_text(json.dumps(poses))
    bpy.data.objects.remove(scene.iris.views[3].camera)
    bpy.ops.iris.check()
    bpy.context.view_layer.update()
    assert len(scene.objects) == count and all(view.camera is not None for view in scene.iris.views)
    assert abs((first.matrix_world.translation - before).length - 0.1) < 1e-5
    assert scene.iris.room == room and "iris_applied" in scene  # its mesh is what it was

    photo = next(capture.rglob("002.png"))
    photo.rename(home / "away.png")
    bpy.ops.iris.check()
    assert [view.name for view in scene.iris.views] == ["000", "001", "003", "004", "005"]
    (home / "away.png").rename(photo)
    bpy.ops.iris.check()
    assert len(scene.iris.views) == 6 and len(scene.objects) == count  # it came back to its own camera

    assert len(scene.iris.lamps) > 0
    os.replace({str(higher)!r}, capture / "mesh.ply")
    height = max(v.co.z for v in room.data.vertices) - min(v.co.z for v in room.data.vertices)
    bpy.ops.iris.check()
    now = max(v.co.z for v in room.data.vertices) - min(v.co.z for v in room.data.vertices)
    assert scene.iris.room == room and len(scene.objects) == count and abs(now - 1.01 * height) < 1e-4
    assert "iris_applied" not in scene and len(scene.iris.lamps) == 0  # the result is of another mesh
    assert not [m for m in bpy.data.meshes if not m.users]
    """
    in_blender(package, tmp_path, body)


def test_a_failed_import_leaves_the_capture_and_the_disk_as_they_were(package, tmp_path, worker, nerfstudio_room):
    body = f"""
    preferences.python = {str(worker)!r}
    capture = {str(nerfstudio_room.root)!r}
    bpy.ops.iris.import_capture(filepath=capture)
    assert scene.objects["Cube"].hide_render and scene.objects["Light"].hide_viewport  # they stood in the room
    shown = [view.camera for view in scene.iris.views if not view.camera.hide_get()]
    assert shown == [scene.camera]
    scene.iris.all_cameras = True
    assert not any(view.camera.hide_get() for view in scene.iris.views)
    before = [getattr(scene.iris, name) for name in ("source", "capture", "room", "result")], len(scene.iris.views)
    wrong = home / "holiday"
    wrong.mkdir()
    (wrong / "transforms.json").write_text("{{}}")
    fails(bpy.ops.iris.import_capture, "", filepath=str(wrong / "transforms.json"))
    now = [getattr(scene.iris, name) for name in ("source", "capture", "room", "result")], len(scene.iris.views)
    assert now == before and scene.iris.importing == str(wrong)
    assert sorted(path.name for path in home.iterdir() if "holiday" in path.name) == ["holiday"]
    assert list(wrong.iterdir()) == [wrong / "transforms.json"]
    from importlib import import_module
    steps = import_module(KEY + ".operators.ui.steps")
    assert steps.check_step(scene).state == "failed"  # the panel says why
    bpy.ops.iris.solve()
    assert Path(capture + "-iris", "report.json").is_file()
    bpy.ops.iris.check()
    assert not scene.iris.importing and steps.check_step(scene).state == "done"
    """
    in_blender(package, tmp_path, body)


def test_what_was_applied_is_undone_and_matched_without_the_result_folder(package, tmp_path, worker, nerfstudio_room):
    body = f"""
    preferences.python = {str(worker)!r}
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    shutil.rmtree({str(nerfstudio_room.root)!r} + "-iris")
    assert not bpy.ops.iris.apply.poll()
    assert bpy.ops.iris.match_photo(on=True) == {{"FINISHED"}} and "iris_matched" in scene
    assert bpy.ops.iris.match_photo(on=False) == {{"FINISHED"}} and "iris_matched" not in scene
    assert bpy.ops.iris.confidence(on=True) == {{"FINISHED"}} and bpy.ops.iris.confidence(on=False) == {{"FINISHED"}}
    assert bpy.ops.iris.restore() == {{"FINISHED"}} and "iris_applied" not in scene
    """
    in_blender(package, tmp_path, body)


def test_looks_solo_and_known_lumens(package, tmp_path, worker, nerfstudio_room):
    body = f"""
    import math
    preferences.python = {str(worker)!r}
    bpy.ops.iris.import_capture(filepath={str(nerfstudio_room.root)!r})
    assert not bpy.ops.iris.look.poll() and not bpy.ops.iris.solo.poll()
    bpy.ops.iris.solve()
    bpy.ops.iris.apply()
    lamp = scene.iris.lamps[0]
    outside = scene.world.node_tree.nodes["Background"].inputs["Strength"]
    lamp.strength, lamp.color = 3, (0, 1, 0)
    for look, on, share in (("LAMPS", True, 0), ("DAY", False, 1), ("BLACKOUT", False, 0), ("PHOTOGRAPHED", True, 1)):
        bpy.ops.iris.look(look=look)
        assert (lamp.on, outside.default_value) == (on, share), look
    assert lamp.strength == 12 and all(abs(c - v / 12) < 1e-6 for c, v in zip(lamp.color, (12, 10, 8)))
    lamp.strength = 5
    fails(bpy.ops.iris.save_look, "no name", name=" ")
    bpy.ops.iris.save_look(name="Dim")
    bpy.ops.iris.look(look="PHOTOGRAPHED")
    bpy.ops.iris.own_look(name="Dim")
    assert lamp.strength == 5
    bpy.ops.iris.restore()
    bpy.ops.iris.apply()
    lamp = scene.iris.lamps[0]
    assert lamp.strength == 12
    bpy.ops.iris.own_look(name="Dim")
    assert lamp.strength == 5
    (preset,) = Path(bpy.utils.user_resource("SCRIPTS", path="presets/iris_looks")).iterdir()
    assert preset.name == "Dim.json" and home in preset.parents
    del scene["iris_own_looks"]  # as in another file
    lamp.strength = 3
    bpy.ops.iris.own_look(name="Dim")
    assert abs(lamp.strength - 5) < 1e-5
    preset.write_text('{{"lamps": 7}}')
    fails(bpy.ops.iris.own_look, "'lamps' is int", name="Dim")
    bpy.ops.iris.forget_look(name="Dim")
    fails(bpy.ops.iris.own_look, "no look 'Dim'", name="Dim")
    bpy.ops.iris.look(look="PHOTOGRAPHED")
    bpy.ops.iris.anchor(lumens=800)
    flux = math.pi * 4 * (0.2126 * 12 + 0.7152 * 10 + 0.0722 * 8)
    assert abs(scene.iris.lumens_per_unit * flux / 800 - 1) < 1e-5
    assert abs(lamp.watts / (math.pi * 4 * 12 * 800 / flux / 177.83) - 1) < 1e-5
    assert scene.iris.scale_anchor == f"800 lm of {{lamp.material.name}}"
    bpy.ops.iris.forget_scale()
    assert (scene.iris.lumens_per_unit, scene.iris.scale_anchor) == (0, "")
    assert abs(lamp.watts / (math.pi * 4 * 12) - 1) < 1e-5
    lamp.strength = 6
    assert abs(lamp.watts / (math.pi * 4 * 6) - 1) < 1e-5
    lamp.strength = 12
    sun = bpy.data.objects.new("my sun", bpy.data.lights.new("my sun", "SUN"))
    scene.collection.objects.link(sun)
    bpy.ops.iris.hide_lights()
    assert sun.hide_render and sun.hide_viewport
    bpy.ops.iris.solo()
    assert lamp.on

    bpy.ops.iris.area_lamp()
    light = bpy.data.objects[lamp.material.name + " Light"]
    assert light.data.type == "AREA" and not light.visible_camera
    assert abs(light.data.energy - math.pi * 10 * 12) < 0.01  # a wall of ten square metres
    assert abs(lamp.strength - 12) < 1e-5
    lamp.on = False
    assert light.data.energy == 0
    fails(bpy.ops.iris.area_lamp, "replaced already")
    bpy.ops.iris.hide_lights()
    assert not light.hide_render
    lamp.on = True
    from mathutils import Vector
    corners = [scene.iris.room.matrix_world @ Vector(corner) for corner in scene.iris.room.bound_box]
    scene.cursor.location = sum(corners, Vector()) / 8
    bpy.ops.iris.probe(width=64, samples=4)
    bpy.ops.iris.probe(width=64, samples=4)
    probe = bpy.data.images["IRIS probe-02"]
    bar = sys.modules[KEY + ".operators.status_bar"]
    assert bar._end["text"].startswith("Rendering the HDRI Probe: done in ") and not bar.lines(), bar._end
    header = bpy.types.STATUSBAR_HT_header
    header.draw = lambda self, context: None  # as setting its text does
    bar.register()
    bar.register()
    assert header.draw._draw_funcs.count(bar.draw) == 1
    assert tuple(probe.size) == (64, 32) and probe.packed_file
    assert 11 < max(probe.pixels) < 13, max(probe.pixels)
    assert "probe-02.exr" in bpy.context.preferences.studio_lights
    assert sorted(path.name for path in Path(bpy.path.abspath(probe.filepath)).parent.iterdir()) == [
        "probe-01.exr", "probe-02.exr"]
    bpy.ops.iris.area_lamp(on=False)
    assert not [thing for thing in bpy.data.lights if thing.type == "AREA"]
    bpy.ops.iris.area_lamp(kind="IES")
    light = bpy.data.objects[lamp.material.name + " Light"]
    assert light.data.type == "POINT" and len(bpy.data.texts) == 1 and abs(light.data.energy - math.pi * 10 * 12) < 0.01
    bpy.ops.iris.area_lamp(on=False)
    assert not bpy.data.texts
    assert abs(lamp.strength - 12) < 1e-5
    """
    in_blender(package, tmp_path, body)


# ---- what goes wrong -----------------------------------------------------------------------------------------------


def test_every_user_error_has_its_message(package, tmp_path, worker, nerfstudio_room, monkeypatch):
    killed = fake_solver(tmp_path, "import signal; os.kill(os.getpid(), signal.SIGKILL)", "killed")
    bare = fake_solver(tmp_path, f"os.execv({sys.executable!r}, [{sys.executable!r}, '-S', *sys.argv[1:]])", "bare")
    photo = sorted(nerfstudio_room.root.rglob("*.png"))[0]
    body = f"""
    capture = {str(nerfstudio_room.root)!r}
    assert not bpy.ops.iris.import_capture.poll() and not bpy.ops.iris.solve.poll()
    preferences.python = "/no/such/python"
    fails(bpy.ops.iris.import_capture, "cannot be started", "set the solver's Python", filepath=capture)
    preferences.python = {str(bare)!r}
    fails(bpy.ops.iris.import_capture, "lacks numpy", filepath=capture)
    preferences.python = {str(worker)!r}
    photo = Path({str(photo)!r})
    kept = photo.read_bytes()
    photo.unlink()
    bpy.ops.iris.import_capture(filepath=capture)  # goes on without it, and says so
    assert len(scene.iris.views) == 5 and photo.stem in scene.iris.warnings
    photo.write_bytes(kept)
    bpy.ops.iris.import_capture(filepath=capture)
    preferences.python = {str(killed)!r}
    fails(bpy.ops.iris.solve, "was killed (signal 9)", "goes on from the last finished stage")
    fails(bpy.ops.iris.apply, "Solve first")

    # The log and the reason can be looked at and copied.
    bpy.ops.iris.show_log(job="solve")
    assert "IRIS solve log" in bpy.data.texts

    # A folder that cannot be written: a file stands where it should be.
    preferences.python = {str(worker)!r}
    (home / "in the way").write_text("")
    scene.iris.result = str(home / "in the way" / "result")
    fails(bpy.ops.iris.solve, "cannot be written", "another folder")
    scene.iris.result = ""

    # Everything that was written is deleted by hand.
    bpy.ops.iris.solve()
    shutil.rmtree(capture + "-iris")
    assert not bpy.ops.iris.apply.poll()
    bpy.ops.iris.solve()
    (Path(capture + "-iris") / "materials" / "base_color.exr").unlink()
    fails(bpy.ops.iris.apply, "base_color.exr", "restore the file")
    bpy.data.objects.remove(scene.iris.room)
    shutil.rmtree(capture + "-iris")
    bpy.ops.iris.solve()
    fails(bpy.ops.iris.apply, "import the capture again")
    bpy.ops.iris.check()
    bpy.ops.iris.apply()
    """
    in_blender(package, tmp_path, body)


def test_an_environment_needs_online_access_and_its_python_is_tested(package, tmp_path):
    pytest.importorskip("torch")
    body = f"""
    assert not bpy.app.online_access
    assert not bpy.ops.iris.make_environment.poll()
    assert not bpy.ops.iris.test_python.poll()
    preferences.python = {sys.executable!r}
    assert bpy.ops.iris.test_python() == {{"FINISHED"}}
    folders, jobs = (sys.modules[KEY + name] for name in (".operators.folders", ".iris_addon.blender.worker.jobs"))
    found = jobs.record("test", folders.environment_folder()).what
    assert found.startswith({f"Python {platform.python_version()}, torch "!r}) and found.count(", ") == 2, found
    preferences.python = "/no/such/python"
    fails(bpy.ops.iris.test_python, "cannot be started")
    """
    in_blender(package, tmp_path, body)


def test_the_plot_of_a_response_goes_from_corner_to_corner():
    from iris_addon.blender.apply.review import curve_plot

    picture = curve_plot(np.tile(np.linspace(0, 1, 1024) ** (1 / 2.2), (3, 1)))
    white = (picture == 1.0).all(axis=-1)
    assert white[-1, 0] and white[0, -1] and white.any(axis=0).all()
    assert np.flatnonzero(white[:, 128])[0] == pytest.approx(256 * (1 - 0.5 ** (1 / 2.2)), abs=2)
    colored = curve_plot(np.stack([np.linspace(0, 1, 1024) ** g for g in (0.4, 0.5, 0.6)]))
    assert not (colored == 1.0).all(axis=-1).any()


def test_a_result_is_described_in_sentences():
    from iris_addon.blender.apply.review import model_sentences

    report = json.loads((ROOT / "assets" / "demo_solved" / "report.json").read_text())
    assert model_sentences(report) == [
        "3 lamps found. No light comes in from outside.",
        "266 surfaces: 190 glossy and 8 metal, the others matte.",
        "Matte surfaces look duller at grazing angles, as under a coat of varnish.",
        "Exposures are as recorded.",
        "Typical error on pixels that the solve was not shown: 3.6 % of white (28.8 dB).",
        "Solved from 28 photos.",
    ]
    model = report["model"]
    model |= {"lamps": 1, "unseen_lamps": 1, "outside_directions": 12, "light_states": {"day": {}, "night": {}}}
    model |= {"mirrors": 1, "faces_of_panes": 2, "diffuse": {"lobe": "burley"}}
    model["response"] = {"family": "identity", "exposures": "estimated"}
    light, materials, lobe, exposures, quality, photos = model_sentences({**report, "excluded": ["blurred", "dark"]})
    assert light == ("1 lamp found, in no photo. Light comes in from outside. Photographed in 2 light states.")
    assert materials.endswith("the others matte. 1 is a mirror. Panes of glass are seen through.")
    assert "plaster" in lobe and exposures == "Exposures were estimated from the photos."
    assert quality.endswith(": 28.8 dB.") and photos == "Solved from 28 photos; left out: blurred, dark."
    model |= {"lamps": 0, "sun": True}
    assert model_sentences(report)[0].startswith("No lamp was found. The sun shines in.")
    assert model_sentences({"model": [], "holdout_psnr": "good"}) == []  # of another version, or damaged


def test_a_histogram_becomes_a_line_of_blocks():
    from iris_addon.blender.apply.review import sparkline

    assert sparkline([0, 0.01, 0.25, 1]) == "▁▂▅█"
    assert sparkline([0, 0]) == "▁▁"
    assert sparkline([1] * 31 + [0]) == "█" * 15 + "▆"


def test_the_interface_is_in_the_english_of_blender():
    """Names, tooltips and reports; a class of Blender has its docstring for a tooltip."""
    british = re.compile(
        r"\b(colour|grey|centre|metre|behaviour|normalis|recognis|optimis|neighbour|favour)", re.IGNORECASE
    )
    found = []
    for path in (ROOT / "operators").rglob("*.py"):
        tree = ast.parse(path.read_text())
        docs = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef)
            and not (isinstance(node, ast.ClassDef) and node.name.startswith("IRIS_OT"))
            and isinstance(node.body[0], ast.Expr)
        }
        said = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
        ]
        found += [
            f"{path.name}:{node.lineno} {node.value}"
            for node in said
            if british.search(node.value) and " " in node.value
        ]
    assert found == []
