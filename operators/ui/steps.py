"""How far the work of a scene is: the state of each step in the sidebar, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ...iris_addon.blender.apply.on_objects import APPLIED
from ...iris_addon.blender.worker import jobs
from ...iris_addon.results.files import REPORT, result_file
from ..folders import capture_changed, capture_path, check_folder, folder, result_key


@dataclass(frozen=True)
class Step:
    """The state of a step, "done", "stale", "ready", "missing", "running" or "failed", and what to do next."""

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


def data_step(scene: bpy.types.Scene) -> Step:
    """Whether photos, poses and mesh are in the scene."""
    if jobs.running("inspect", check_folder(scene)):
        return Step("running", "Reading the capture")
    if scene.iris.views:
        return Step("done")
    return Step("missing", "Import a capture, or use the photos of this scene")


def check_step(scene: bpy.types.Scene) -> Step:
    """Whether the capture was checked."""
    settings = scene.iris
    record = jobs.record("inspect", check_folder(scene))
    if record.state == "running":
        return Step("running", "Measuring the photos")
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
    """Whether there is a result of the current capture."""
    record = jobs.record("solve", folder(scene))
    if record.state == "running":
        return Step("running")
    if record.state == "failed":
        return Step("failed", "Read the reason below")
    key = result_key(scene)
    capture = capture_path(scene)
    if record.state in ("cancelled", "interrupted"):
        return Step("stale", "Resume where it stopped")
    if not key:
        return Step("ready", "Choose a preset and press Solve") if scene.iris.views else Step("missing", "First: data")
    if capture is not None and capture_changed(capture, result_file(folder(scene), REPORT)):
        return Step("stale", "The capture has changed: solve again")
    return Step("done")


def review_step(scene: bpy.types.Scene) -> Step:
    """Whether the result is applied to the objects."""
    key = result_key(scene)
    applied = scene.get(APPLIED)
    if not key:
        return Step("missing", "First: solve")
    if applied is None:
        return Step("ready", "Look at the result, then apply it")
    return Step("done") if applied == key else Step("stale", "Another result is applied: apply again")


def relight_step(scene: bpy.types.Scene) -> Step:
    """Whether there are lamps to edit."""
    if scene.get(APPLIED) is None:
        return Step("missing", "First: apply")
    return Step("done")


def export_step(scene: bpy.types.Scene) -> Step:
    """Whether there is a result to export."""
    return Step("done") if result_key(scene) else Step("missing", "First: solve")
