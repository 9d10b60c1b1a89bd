"""Preconditions that several operators share; their poll says what is missing."""

from __future__ import annotations

import bpy

from ..iris_addon.blender.apply.on_objects import APPLIED
from ..iris_addon.blender.worker import jobs
from .folders import capture_path, check_folder, result_key, solver_python


class NeedsCapture:
    """Mixin of operators that let a capture be solved."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A capture is chosen, or photos were found in the scene."""
        scene = context.scene
        if capture_path(scene) is None or (scene.iris.source == "SCENE" and not scene.iris.views):
            cls.poll_message_set("Import a capture first")  # type: ignore[attr-defined]
            return False
        return True


class NeedsReader:
    """Mixin of operators that let the solver's Python read a capture."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The solver's Python is set, and it is not reading yet."""
        if not solver_python(context):
            cls.poll_message_set("Set the solver's Python in the preferences of IRIS first")  # type: ignore[attr-defined]
            return False
        return jobs.running("inspect", check_folder(context.scene)) is None


class NeedsResult:
    """Mixin of operators on the result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There is a result."""
        if not result_key(context.scene):
            cls.poll_message_set("Solve first")  # type: ignore[attr-defined]
            return False
        return True


class NeedsApplied:
    """Mixin of operators on a room with an applied result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A result was applied."""
        if APPLIED not in context.scene:
            cls.poll_message_set("Apply a result first")  # type: ignore[attr-defined]
            return False
        return True
