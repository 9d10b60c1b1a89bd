"""Import captures through the solver's reader: from File > Import, the panel, a dropped file, or the open scene."""
# Blender declares properties as annotations.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..iris_addon.base.errors import IrisError
from ..iris_addon.base.files import require_own_folder
from ..iris_addon.blender.apply.on_objects import APPLIED
from ..iris_addon.blender.apply.photo_cameras import forget_given_pose
from ..iris_addon.blender.apply.review import sparkline
from ..iris_addon.blender.scene_in.capture_objects import (
    COLLECTION,
    Inspected,
    add_capture,
    hide_startup_objects,
    inspected_steps,
    refresh_capture,
)
from ..iris_addon.blender.scene_in.scene_capture import read_view_cameras, write_scene_capture
from ..iris_addon.blender.scene_in.solved_demo import CAPTURE as CAPTURE_OF_DEMO
from ..iris_addon.blender.stepwise import Steps, finish
from ..iris_addon.blender.worker import jobs
from ..iris_addon.blender.worker.jobs import inspect_command
from .editors import show_cameras
from .folders import (
    ROOT_PACKAGE,
    capture_path,
    check_folder,
    folder,
    folder_beside,
    inspection_folder,
    own_folder,
    solver_python,
)
from .polls import NeedsReader
from .run_job import run

CAPTURE = "iris_capture"
"""Custom property of a room: its capture."""
COLMAP_FILES = [f"{name}.{kind}" for name in ("cameras", "images", "points3D") for kind in ("bin", "txt")]


class IRIS_OT_import_capture(NeedsReader, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Read photos, poses and mesh of a room, check them and add them to this scene.
    Poses of nerfstudio, Polycam, Record3D, COLMAP, Metashape, RealityScan, Meshroom, OpenMVG, Bundler, ScanNet,
    ScanNet++, ARKitScenes, 7-Scenes, TUM RGB-D or FIPT"""

    bl_idname = "iris.import_capture"
    bl_label = "Import Capture"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender's form

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.json;*.bin;*.txt;*.xml;*.csv;*.sfm;*.out", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Open the file browser, unless a file was dropped."""
        if self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start reading; the capture is added to the scene when that has ended."""
        path = Path(bpy.path.abspath(self.filepath or self.directory))
        if path.name == "" or (not path.exists() and path.parent.is_dir() and "." not in path.name):
            path = path.parent  # the file browser, with a folder but no file chosen
        # Files with poses stand for their capture folder; any other file is the capture itself.
        if path.name == "transforms.json":
            path = path.parent.parent if path.parent.name == "train" else path.parent
        elif path.name in COLMAP_FILES:
            path = path.parent
        return import_from(self, context, path)


class IRIS_OT_import_demo(NeedsReader, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Import the small room that comes with the extension"""

    bl_idname = "iris.import_demo"
    bl_label = "Demo Room"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Import it; results go to the user's folder, never to the extension's."""
        context.scene.iris.metres_per_unit = 0.0  # that of another capture
        return import_from(
            self, context, CAPTURE_OF_DEMO, bpy.utils.extension_path_user(ROOT_PACKAGE, path="demo_room-iris")
        )


class IRIS_OT_use_scene(NeedsReader, bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Take the cameras of this scene that have a background image as photos, and its mesh objects as the room"""

    bl_idname = "iris.use_scene"
    bl_label = "Use This Scene"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the scene as a capture and check it."""
        settings = context.scene.iris
        if settings.source == "SCENE":
            return start_import(self, context)
        before = {name: getattr(settings, name) for name in ("source", "capture", "room", "result")}
        settings.importing = ""
        if settings.views:  # that folder belongs to the imported capture
            settings.result = ""
        settings.source, settings.capture, settings.room = "SCENE", "", None
        # Stored, so that saving the file under another name does not lose the result.
        settings.result = str(own_folder(context.scene))
        if not write_scene(self, context):
            for name, value in before.items():
                setattr(settings, name, value)
            return {"CANCELLED"}
        for thing in context.scene.objects:  # cameras are solved where they stand now
            forget_given_pose(thing)
        return start_check(self, context)


class IRIS_OT_add_capture(bpy.types.Operator):  # noqa: N801 - Blender's naming
    """Add a capture that has been read to the scene"""

    bl_idname = "iris.add_capture"
    bl_label = "Add Capture"
    bl_options = {"UNDO", "INTERNAL"}  # noqa: RUF012 - Blender's form

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the folder of the check and create its objects."""
        scene, where = context.scene, inspection_folder(context.scene)
        settings = scene.iris
        mesh = None
        try:
            inspected, mesh = _prepared.pop(where, None) or finish(_read_steps(scene, where))
            cameras = self._cameras(scene, inspected, mesh)
        except IrisError as error:
            if mesh is not None:
                bpy.data.meshes.remove(mesh)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        _fill(settings, inspected, cameras)
        context.view_layer.update()  # hides only what it knows
        show_cameras(context)
        self.report({"INFO"}, f"{inspected.name}: {len(inspected.views)} photos")
        return {"FINISHED"}

    def _cameras(
        self, scene: bpy.types.Scene, inspected: Inspected, mesh: bpy.types.Mesh | None
    ) -> list[bpy.types.Object | None]:
        """The camera of each photo: the artist's own, that of the present room, or of a room that is added."""
        settings = scene.iris
        if settings.source == "SCENE":
            objects = read_view_cameras(folder(scene))
            return [scene.objects.get(objects.get(view.name, "")) for view in inspected.views]
        assert mesh is not None
        if not _shows(settings.room, settings.capture, scene):
            if settings.room is not None:
                _hide_capture(settings.room)
            settings.room, cameras = add_capture(inspected, mesh, scene)
            settings.room[CAPTURE] = settings.capture
            hidden = hide_startup_objects(scene)
            if hidden:
                self.report({"INFO"}, f"Hidden, they would stand in the room: {', '.join(hidden)} of the start-up file")
            return [*cameras]
        cameras = refresh_capture(inspected, mesh, scene, settings.room)
        if APPLIED not in scene:  # a result of another mesh was removed
            settings.lamps.clear()
        return [*cameras]


_prepared: dict[Path, tuple[Inspected, bpy.types.Mesh | None]] = {}
"""What the next operator adds, by the folder of the check."""


def _read_steps(scene: bpy.types.Scene, folder: Path) -> Steps[tuple[Inspected, bpy.types.Mesh | None]]:
    """Read the check in ``folder``, and make a mesh of it unless the artist's own objects are the room."""
    return inspected_steps(folder, with_mesh=bool(scene.iris.importing) or scene.iris.source != "SCENE")


def import_from(operator: bpy.types.Operator, context: bpy.types.Context, path: Path, result: str = "") -> set[str]:
    """Let the worker read ``path``, and make it the capture of the scene once it has been read.

    Until then, and where it cannot be read, the scene keeps its capture, room and result.

    Args:
        result: the folder for its result; empty: beside it.
    """
    settings = context.scene.iris
    if (settings.source, settings.capture) == ("CAPTURE", str(path)):
        settings.importing = ""
        return start_check(operator, context)
    if settings.source == "CAPTURE" and not settings.capture:  # a folder that was chosen before the capture
        result = settings.result or result
    settings.importing = str(path)

    def commit(settings: bpy.types.PropertyGroup) -> None:
        settings.source, settings.capture, settings.result, settings.importing = "CAPTURE", str(path), result, ""

    absolute = Path(bpy.path.abspath(str(path))).resolve()
    out = Path(bpy.path.abspath(result)).resolve() if result else folder_beside(absolute)
    return _start_inspection(operator, context, absolute, out / "inspection", commit)


def _shows(room: bpy.types.Object | None, capture: str, scene: bpy.types.Scene) -> bool:
    return room is not None and room.get(CAPTURE) == capture and room.name in scene.objects


def _hide_capture(room: bpy.types.Object) -> None:
    """Hide the room of another capture and its photos: it would overlap this one."""
    for collection in room.users_collection:
        if collection.name.startswith(COLLECTION):
            collection.hide_viewport = collection.hide_render = True


def start_import(operator: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
    """Write the scene as a capture if need be, then :func:`start_check`; returns the result of the operator."""
    return start_check(operator, context) if write_scene(operator, context) else {"CANCELLED"}


def start_check(operator: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
    """Let the worker read and check the capture of the scene, then add it; returns the result of the operator."""
    capture = capture_path(context.scene)
    assert capture is not None
    return _start_inspection(operator, context, capture, inspection_folder(context.scene), lambda settings: None)


def _start_inspection(
    operator: bpy.types.Operator,
    context: bpy.types.Context,
    capture: Path,
    target: Path,
    commit: Callable[[bpy.types.PropertyGroup], None],
) -> set[str]:
    """Inspect ``capture`` into ``target``, then ``commit`` it to the settings of the scene and add it."""
    name, job = context.scene.name, check_folder(context.scene)

    def checked() -> bpy.types.Scene | None:
        # Another file may be open by now; it finds the check by its folder.
        scene = bpy.data.scenes.get(name)
        return scene if scene is not None and check_folder(scene) == job else None

    def ended(record: jobs.Record) -> Iterator[str]:
        scene = checked() if record.state == "done" else None
        if scene is None:
            return
        try:
            prepared = yield from _read_steps(scene, target)
            if prepared[1] is not None:
                prepared[1].update_tag()  # is it still there?
        except ReferenceError:  # what was made of it has been undone meanwhile
            prepared = None
        scene = checked()
        if scene is None:
            return
        prepared = prepared or finish(_read_steps(scene, target))
        settings = scene.iris
        try:
            with source_kept_on_failure(settings):
                commit(settings)
                _prepared[inspection_folder(scene)] = prepared
                with bpy.context.temp_override(**_window_of(scene)):
                    bpy.ops.iris.add_capture("EXEC_DEFAULT", True)
        except RuntimeError as error:
            raise IrisError(reported(error), "check the capture again") from error
        finally:
            _prepared.clear()

    try:
        require_own_folder(target)
    except IrisError as error:
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    settings = context.scene.iris
    unit = settings.metres_per_unit if settings.importing or settings.source == "CAPTURE" else 0.0
    return run(operator, "inspect", job, inspect_command(solver_python(context), capture, target, unit), ended)


@contextmanager
def source_kept_on_failure(settings: bpy.types.PropertyGroup) -> Iterator[None]:
    """Inside, a capture is added to a scene; if that fails, the scene has its source and its folders as before."""
    before = {name: getattr(settings, name) for name in ("source", "capture", "result", "importing")}
    try:
        yield
    except (IrisError, RuntimeError):
        for key, value in before.items():
            setattr(settings, key, value)
        raise


def reported(error: Exception) -> str:
    """What an operator reported as an error, which Blender raises where the operator was called from Python."""
    return str(error).strip().removeprefix("Error: ")


def write_scene(operator: bpy.types.Operator, context: bpy.types.Context) -> bool:
    """Write the scene as a capture if that is the source; returns False, with a report, if it cannot be written.

    A scene with an applied result is not what was photographed: then the capture written before is used again.
    """
    scene = context.scene
    if scene.iris.source != "SCENE":
        return True
    if APPLIED in scene and (folder(scene) / "capture" / "transforms.json").is_file():
        operator.report({"INFO"}, "Using the scene as it was before Apply; Restore Originals to include later changes")
        return True
    try:
        for warning in write_scene_capture(scene, context.evaluated_depsgraph_get(), folder(scene)):
            operator.report({"WARNING"}, warning)
    except IrisError as error:
        operator.report({"ERROR"}, str(error))
        return False
    return True


def _window_of(scene: bpy.types.Scene) -> dict[str, object]:
    # A timer has no window in its context, and operators use the scene of the window.
    windows = bpy.context.window_manager.windows
    window = next((window for window in windows if window.scene == scene), None)
    return {"scene": scene} if window is None else {"window": window, "scene": scene}


def _fill(settings: bpy.types.PropertyGroup, inspected: Inspected, cameras: list[bpy.types.Object | None]) -> None:
    left_out = {view.name for view in settings.views if not view.use}
    same = {view.name for view in settings.views} == {view.name for view in inspected.views}
    settings.views.clear()
    for view, camera in zip(inspected.views, cameras, strict=True):
        item = settings.views.add()
        item.name, item.camera, item.aspect = view.name, camera, view.camera.fx / view.camera.fy
        item.exposure, item.metered = view.exposure or 0.0, view.metered or 0.0
        item.saturated, item.seen, item.histogram = view.saturated, view.seen, sparkline(view.histogram)
        item.score, item.shift, item.verdict = view.score, view.shift, view.verdict
        item.problem, item.use = view.problem, not (same and view.name in left_out)
    settings.warnings = "\n".join(inspected.warnings)
    settings.view_index = 0


class IRIS_FH_capture(bpy.types.FileHandler):  # noqa: N801 - Blender's naming
    """Drop a transforms.json, a file of COLMAP's binary model, or cameras of another program into the 3D view."""

    bl_idname = "IRIS_FH_capture"
    bl_label = "IRIS Capture"
    bl_import_operator = "iris.import_capture"
    bl_file_extensions = ".json;.bin;.sfm;.xml;.csv;.out"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """The mouse is over a 3D view."""
        return context.area is not None and context.area.type == "VIEW_3D"
