"""How far the work of a scene is: the state of each step in the sidebar, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...iris_addon.base.errors import IrisError
from ...iris_addon.blender.apply.on_objects import APPLIED
from ...iris_addon.blender.worker import jobs
from ...iris_addon.config import preset
from ...iris_addon.model.texture_size import in_blender
from ...iris_addon.results.files import REPORT, result_file
from ...iris_addon.results.records import read_report
from ..folders import capture_changed, capture_path, check_folder, folder, folds, result_key


@dataclass(frozen=True)
class Step:
    """The state of a step, "done", "stale", "ready", "missing", "running" or "failed", and what to do next."""

    state: str
    hint: str = ""


_REPORTS: dict[Path, tuple[int, dict[str, Any]]] = {}
"""When each report was written, and its content: sections are drawn often, and ask for it each time."""

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
    if solved_without(folder(scene)) != left_out(scene):
        return Step("stale", "Other photos are used: solve again")
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


# ---- which sections are open ---------------------------------------------------------------------------------------

ORDER = {
    "data": data_step,
    "check": check_step,
    "solve": solve_step,
    "review": review_step,
    "relight": relight_step,
}
SECTIONS = (*ORDER, "insert", "export")


def current(scene: bpy.types.Scene) -> tuple[str, Step]:
    """Name and state of the step that is next: the first that is not done, else the last."""
    for name, step_of in ORDER.items():
        step = step_of(scene)
        if step.state != "done":
            return name, step
    return name, step


def is_open(scene: bpy.types.Scene, section: str) -> bool:
    """Whether a section is unfolded: as the artist left it since the current step has begun, else the current one.

    A check with warnings is read before a solve, so that it is open with it.
    """
    now = current(scene)[0]
    left = _left(scene, now)
    if section in left:
        return left[section]
    if not folds():
        return section != "export"
    return section == now or ((section, now) == ("check", "solve") and bool(scene.iris.warnings))


def set_open(scene: bpy.types.Scene, section: str, unfolded: bool) -> None:
    """Fold or unfold a section, until another step is current."""
    now = current(scene)[0]
    left = {**_left(scene, now), section: unfolded}
    scene.iris.folds = " ".join([now, *(f"{name}{'+' if value else '-'}" for name, value in left.items())])


def _left(scene: bpy.types.Scene, now: str) -> dict[str, bool]:
    """What the artist has unfolded and folded since the step ``now`` is current: "solve check+ data-" in the scene."""
    step, *left = scene.iris.folds.split() or [""]
    return {word[:-1]: word.endswith("+") for word in left} if step == now else {}


def left_out(scene: bpy.types.Scene) -> list[str]:
    """Names of the photos that the artist leaves out."""
    return sorted(view.name for view in scene.iris.views if not view.use)


def solved_without(folder: Path) -> list[str]:
    """Names of the photos that the solve in ``folder`` left out."""
    excluded = _report(folder).get("excluded")
    return sorted(map(str, excluded)) if isinstance(excluded, list) else []


def report_of(folder: Path) -> dict[str, Any]:
    """The report of the result in ``folder``, read again only when it has changed; raises IrisError as
    :func:`read_report`."""
    path = result_file(folder, REPORT)
    written = path.stat().st_mtime_ns if path.is_file() else 0
    if _REPORTS.get(path, (-1, {}))[0] != written:
        _REPORTS[path] = written, read_report(folder)
    return _REPORTS[path][1]


def _report(folder: Path) -> dict[str, Any]:
    """:func:`report_of`, empty where there is none."""
    try:
        return report_of(folder)
    except (OSError, IrisError):
        return {}


def texture_options(settings: bpy.types.PropertyGroup) -> dict[str, int]:
    """The size of textures as the command line and job files have it; without what is left to the solver."""
    options = {} if settings.atlas_size == "auto" else {"atlas_size": int(settings.atlas_size)}
    return {**options, "texels_per_metre": settings.texels_per_metre} if settings.texels_per_metre else options


def textures_line(settings: bpy.types.PropertyGroup) -> str:
    """The most that the textures will take in Blender: "Textures: up to 2048 x 2048, 0.1 GB"."""
    asked = preset(settings.preset, **texture_options(settings)).texture_size
    return f"Textures: {'' if asked.side else 'up to '}{in_blender(asked.most)}"


def solved_line(folder: Path) -> str:
    """What the solve in ``folder`` ended with, "Solved: 4 lights in 52 s"; empty where there is no result."""
    report = _report(folder)
    if not report:
        return ""
    model, seconds = report.get("model"), report.get("seconds")
    lights = model.get("lamps") if isinstance(model, dict) else None
    if not isinstance(lights, int) or not isinstance(seconds, dict):
        return "Solved"
    spent = sum(value for value in seconds.values() if isinstance(value, int | float))
    return f"Solved: {lights} {'light' if lights == 1 else 'lights'} in {duration(spent)}"


def atlas_line(folder: Path) -> str:
    """The textures of the result in ``folder``, "1024 x 1024, 29 MB, 92 texels/m"; empty where that is not known."""
    try:
        atlas = _report(folder)["atlas"]
        return f"{in_blender(atlas['side'], atlas.get('bytes_in_blender'))}, {atlas['texels_per_metre']:.0f} texels/m"
    except (KeyError, TypeError, ValueError):  # none, or of an older version
        return ""


def duration(seconds: float) -> str:
    """``seconds`` as a person says them."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
