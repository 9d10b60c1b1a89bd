"""Where the work of a scene lies on disk: capture, check, result; and the solver's Python environment."""

from __future__ import annotations

import sys
import time
from hashlib import sha256
from pathlib import Path

import bpy

from ..iris_addon.base.files import user_folder
from ..iris_addon.blender.worker import jobs
from ..iris_addon.results.files import REPORT, result_file

ROOT_PACKAGE = str(__package__).rpartition(".")[0]
"""The extension as Blender names it, ``bl_ext.<repository>.iris``."""


def capture_path(scene: bpy.types.Scene) -> Path | None:
    """The capture to solve: the chosen one, or the one written from the scene; None where there is none."""
    if scene.iris.source == "SCENE":
        return folder(scene) / "capture"
    return Path(bpy.path.abspath(scene.iris.capture)).resolve() if scene.iris.capture else None


def folder(scene: bpy.types.Scene) -> Path:
    """The folder for checks and results: the chosen one, else beside the capture or the .blend, else the user's."""
    settings = scene.iris
    if settings.result:
        return Path(bpy.path.abspath(settings.result)).resolve()
    if settings.source == "CAPTURE" and settings.capture:
        capture = capture_path(scene)
        assert capture is not None
        return folder_beside(capture)
    name = bpy.path.clean_name(scene.name)  # "Day/Night" names a scene, but cannot name a folder
    if bpy.data.filepath:
        return Path(f"{Path(bpy.data.filepath).with_suffix('')}.{name}-iris")
    return Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path=f"unsaved/{name}"))


def folder_beside(capture: Path) -> Path:
    """The folder for the result of ``capture`` where none was chosen."""
    capture = capture if capture.is_dir() else capture.parent
    return capture.with_name(f"{capture.name}-iris")


def own_folder(scene: bpy.types.Scene) -> Path:
    """:func:`folder`, made unique where the file is not saved, so that no other unsaved file uses it."""
    where = folder(scene)
    unsaved = not scene.iris.result and not bpy.data.filepath
    return where.with_name(f"{where.name}-{time.time_ns():x}") if unsaved else where


def look_presets() -> Path:
    """Where the artist's looks are kept for other files, among Blender's presets; made by who writes there."""
    return Path(bpy.utils.user_resource("SCRIPTS", path="presets/iris_looks"))


def inspection_folder(scene: bpy.types.Scene) -> Path:
    """Where the check of the capture lies, with the photos that the cameras show."""
    return folder(scene) / "inspection"


def check_folder(scene: bpy.types.Scene) -> Path:
    """The folder of the job that checks: of the capture that is being imported, else of the present one.

    It is the user's and not the capture's, so that nothing is left beside a folder that turns out to be no capture.
    """
    checked = scene.iris.importing or str(capture_path(scene) or folder(scene))
    return Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path=f"checks/{sha256(checked.encode()).hexdigest()[:16]}"))


def result_key(scene: bpy.types.Scene) -> str:
    """Identifies the result on disk; empty where there is none."""
    try:
        return f"{folder(scene)}#{result_file(folder(scene), REPORT).stat().st_mtime_ns}"
    except OSError:
        return ""


def capture_changed(capture: Path, result: Path) -> bool:
    """Whether the poses of ``capture`` were written after the file ``result``."""
    # The modification time of the folder changes with every file in it, so that of the poses decides.
    poses = ("transforms.json", "train/transforms.json", "sparse/0/images.bin", "sparse/0/images.txt")
    candidates = (capture, *(capture / name for name in poses))
    times = [path.stat().st_mtime for path in candidates if path.is_file()]
    return bool(times) and max(times) > result.stat().st_mtime


# ---- the solver's Python -------------------------------------------------------------------------------------------


def environment_folder() -> Path:
    """The folder for an environment created here; this does not create it.

    On Windows it is a short one: below the extension's own, files of torch have more than the 260 characters that
    Windows takes.
    """
    if sys.platform == "win32":
        return user_folder() / "environment"
    return Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path="environment"))


def environment_python(folder: Path) -> Path:
    """The Python of a virtual environment."""
    windows = folder / "venv" / "Scripts" / "python.exe"
    return windows if windows.is_file() else folder / "venv" / "bin" / "python"


def solver_python(context: bpy.types.Context) -> str:
    """Path of the solver's Python: the chosen one, or the one created here; empty where there is neither."""
    chosen = bpy.path.abspath(context.preferences.addons[ROOT_PACKAGE].preferences.python)
    if chosen:  # called at every redraw, so the disk is read only if nothing is chosen
        return chosen
    made = environment_python(environment_folder())
    return str(made) if made.is_file() and jobs.record("environment", environment_folder()).state == "done" else ""


def job_folder(name: str, context: bpy.types.Context) -> Path:
    """The folder of the job ``name`` for the current scene or, for jobs on the environment, for the preferences."""
    if name in ("environment", "test"):
        return environment_folder()
    return check_folder(context.scene) if name == "inspect" else folder(context.scene)


def folds() -> bool:
    """Whether only the current step is open in the sidebar, by the preferences."""
    return bool(bpy.context.preferences.addons[ROOT_PACKAGE].preferences.fold_steps)


def unit_option(scene: bpy.types.Scene) -> dict[str, float]:
    """:func:`metres_per_unit` as an option of a solve and a key of a job, where it is given."""
    unit = metres_per_unit(scene)
    return {"metres_per_unit": round(unit, 9)} if unit > 0 else {}


def metres_per_unit(scene: bpy.types.Scene) -> float:
    """The unit that the artist gave the imported capture, 0 where it has its own; a scene of Blender's has one."""
    return scene.iris.metres_per_unit if scene.iris.source == "CAPTURE" else 0.0
