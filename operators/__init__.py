"""What Blender shows and runs: preferences, scene settings, operators, the panel."""

from __future__ import annotations

import bpy

from . import panel, preferences, settings, solve

CLASSES = (
    preferences.IrisPreferences,
    settings.IrisSettings,
    solve.IRIS_OT_solve,
    solve.IRIS_OT_cancel,
    panel.IRIS_PT_solve,
)


def register() -> None:
    """Add everything to Blender."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.iris = bpy.props.PointerProperty(type=settings.IrisSettings)


def unregister() -> None:
    """Stop a solve that runs and take everything out of Blender."""
    solve.stop()
    del bpy.types.Scene.iris
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
