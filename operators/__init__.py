"""What Blender shows and runs: preferences, scene settings, operators, panels."""

from __future__ import annotations

import bpy

from . import (
    apply,
    check,
    data,
    export,
    match,
    onto_photo,
    panel,
    place,
    preferences,
    preview,
    review,
    settings,
    solve,
    watch,
)

CLASSES = (
    preferences.IrisPreferences,
    preferences.IRIS_OT_test_python,
    preferences.IRIS_OT_make_environment,
    settings.IrisView,
    settings.IrisLamp,
    settings.IrisSettings,
    watch.IRIS_OT_cancel,
    watch.IRIS_OT_copy_error,
    watch.IRIS_OT_show_log,
    data.IRIS_OT_import_capture,
    data.IRIS_OT_import_demo,
    data.IRIS_OT_use_scene,
    data.IRIS_OT_add_capture,
    data.IRIS_FH_capture,
    check.IRIS_OT_check,
    check.IRIS_OT_step_photo,
    solve.IRIS_OT_solve,
    review.IRIS_OT_review,
    review.IRIS_OT_confidence,
    apply.IRIS_OT_apply,
    apply.IRIS_OT_restore,
    match.IRIS_OT_match_photo,
    match.IRIS_OT_mix_lights,
    place.IRIS_OT_place,
    onto_photo.IRIS_OT_onto_photo,
    export.IRIS_OT_export,
    panel.IRIS_UL_views,
    panel.IRIS_UL_lamps,
    panel.IRIS_PT_iris,
    panel.IRIS_PT_data,
    panel.IRIS_PT_check,
    panel.IRIS_PT_solve,
    panel.IRIS_PT_review,
    panel.IRIS_PT_relight,
    panel.IRIS_PT_export,
)


def register() -> None:
    """Add everything to Blender."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.iris = bpy.props.PointerProperty(type=settings.IrisSettings)
    bpy.types.Camera.iris_exposure = settings.EXPOSURE
    preview.register()
    data.register()
    watch.register()


def unregister() -> None:
    """Stop what runs and take everything out of Blender."""
    watch.unregister()
    data.unregister()
    preview.unregister()
    del bpy.types.Scene.iris, bpy.types.Camera.iris_exposure
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
