"""Where the work of a scene lies on disk, and how each step of it stands."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..iris_addon.blender.apply.on_objects import APPLIED
from ..iris_addon.blender.worker import jobs
from ..iris_addon.results.files import REPORT, result_file
from .preferences import ROOT_PACKAGE


@dataclass(frozen=True)
class Step:
    """How a step stands: "done", "stale", "ready", "missing", "running" or "failed", and what to do next."""

    state: str
    hint: str = ""


ICONS = {
    "done": "CHECKMARK",
    "stale": "FILE_REFRESH",
    "ready": "LAYER_ACTIVE",
    "missing": "LAYER_USED",
    "running": "SORTTIME",
    "failed": "ERROR",
}


def capture_path(scene: bpy.types.Scene) -> Path | None:
    """The capture that is solved: the one chosen, or the one written from the scene; None where there is none."""
    if scene.iris.source == "SCENE":
        return folder(scene) / "capture"
    return Path(bpy.path.abspath(scene.iris.capture)).resolve() if scene.iris.capture else None


def folder(scene: bpy.types.Scene) -> Path:
    """Where checks and results of ``scene`` go: as chosen, beside the capture, beside the .blend, else the user's."""
    settings = scene.iris
    if settings.result:
        return Path(bpy.path.abspath(settings.result)).resolve()
    if settings.source == "CAPTURE" and settings.capture:
        capture = capture_path(scene)
        assert capture is not None
        capture = capture if capture.is_dir() else capture.parent
        return capture.with_name(f"{capture.name}-iris")
    name = bpy.path.clean_name(scene.name)  # "Day/Night" is a name of a scene, and no name of a folder
    if bpy.data.filepath:
        return Path(f"{Path(bpy.data.filepath).with_suffix('')}.{name}-iris")
    return Path(bpy.utils.extension_path_user(ROOT_PACKAGE, path=f"unsaved/{name}"))


def own_folder(scene: bpy.types.Scene) -> Path:
    """:func:`folder`, but one that no other unsaved file finds."""
    where = folder(scene)
    unsaved = not scene.iris.result and not bpy.data.filepath
    return where.with_name(f"{where.name}-{time.time_ns():x}") if unsaved else where


def inspection_folder(scene: bpy.types.Scene) -> Path:
    """Where the check of the capture lies."""
    return folder(scene) / "inspection"


def result_key(scene: bpy.types.Scene) -> str:
    """Stands for the result as it is on disk now; empty where there is none."""
    try:
        return f"{folder(scene)}#{result_file(folder(scene), REPORT).stat().st_mtime_ns}"
    except OSError:
        return ""


# ---- steps ---------------------------------------------------------------------------------------------------------


def data_step(scene: bpy.types.Scene) -> Step:
    """Photos, poses and mesh are in the scene."""
    if jobs.running("inspect", inspection_folder(scene)):
        return Step("running", "Reading the capture")
    if scene.iris.views:
        return Step("done")
    return Step("missing", "Import a capture, or use the photos of this scene")


def check_step(scene: bpy.types.Scene) -> Step:
    """Somebody can know whether a solve is worth its time."""
    settings = scene.iris
    record = jobs.record("inspect", inspection_folder(scene))
    if record.state == "running":
        return Step("running", "Looking at the photos")
    if record.state in ("failed", "interrupted"):
        return Step("failed", "The capture cannot be used as it is")
    if not settings.views:
        return Step("missing", "First: data")
    if any(view.camera is None for view in settings.views):
        return Step("stale", "Cameras were removed: check again")
    if settings.warnings:
        return Step("done", "Read the warnings")
    return Step("done", "")


def solve_step(scene: bpy.types.Scene) -> Step:
    """A result is there."""
    record = jobs.record("solve", folder(scene))
    if record.state == "running":
        return Step("running")
    if record.state == "failed":
        return Step("failed", "Read the reason below")
    key = result_key(scene)
    capture = capture_path(scene)
    if record.state in ("cancelled", "interrupted"):
        return Step("stale", "Go on where it stopped")
    if not key:
        return Step("ready", "Choose a preset and press Solve") if scene.iris.views else Step("missing", "First: data")
    if capture is not None and _newer(capture, result_file(folder(scene), REPORT)):
        return Step("stale", "The capture has changed: solve again")
    return Step("done")


def review_step(scene: bpy.types.Scene) -> Step:
    """The result is on the objects."""
    key = result_key(scene)
    applied = scene.get(APPLIED)
    if not key:
        return Step("missing", "First: solve")
    if applied is None:
        return Step("ready", "Look at the result, then apply it")
    return Step("done") if applied == key else Step("stale", "Another result is on the objects: apply again")


def relight_step(scene: bpy.types.Scene) -> Step:
    """There are lamps to turn."""
    if scene.get(APPLIED) is None:
        return Step("missing", "First: apply")
    return Step("done")


def export_step(scene: bpy.types.Scene) -> Step:
    """There is something to write."""
    return Step("done") if result_key(scene) else Step("missing", "First: solve")


def _newer(capture: Path, result: Path) -> bool:
    # The folder's own time changes with every file in it, so the poses are asked.
    poses = ("transforms.json", "train/transforms.json", "sparse/0/images.bin", "sparse/0/images.txt")
    candidates = (capture, *(capture / name for name in poses))
    times = [path.stat().st_mtime for path in candidates if path.is_file()]
    return bool(times) and max(times) > result.stat().st_mtime
