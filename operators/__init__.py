"""What Blender runs and shows: operators here; panels, preferences and scene settings in :mod:`.ui`."""

from __future__ import annotations

import bpy

from . import (
    apply,
    area_lamp,
    check,
    compositing,
    environment,
    export,
    farm,
    import_capture,
    menus,
    onto_photo,
    onto_plate,
    picture_looks,
    place,
    probe,
    relight,
    review,
    run_job,
    scale,
    solve,
    solved_demo,
)
from .ui import icons, lamp_highlight, panels, photo_list, preferences, settings, solve_preview, wipe, wipe_line

CLASSES = (
    preferences.IrisPreferences,
    environment.IRIS_OT_test_python,
    environment.IRIS_OT_make_environment,
    settings.IrisView,
    settings.IrisLamp,
    settings.IrisSettings,
    run_job.IRIS_OT_cancel,
    run_job.IRIS_OT_copy_error,
    run_job.IRIS_OT_show_log,
    import_capture.IRIS_OT_import_capture,
    import_capture.IRIS_OT_import_demo,
    solved_demo.IRIS_OT_open_demo,
    import_capture.IRIS_OT_use_scene,
    import_capture.IRIS_OT_add_capture,
    import_capture.IRIS_FH_capture,
    check.IRIS_OT_check,
    check.IRIS_OT_step_photo,
    photo_list.IRIS_OT_next_problem,
    solve.IRIS_OT_solve,
    review.IRIS_OT_review,
    review.IRIS_OT_confidence,
    review.IRIS_OT_next_photos,
    apply.IRIS_OT_apply,
    apply.IRIS_OT_restore,
    relight.IRIS_OT_look,
    relight.IRIS_OT_save_look,
    relight.IRIS_OT_own_look,
    relight.IRIS_OT_forget_look,
    picture_looks.IRIS_OT_look_pictures,
    relight.IRIS_OT_solo,
    scale.IRIS_OT_anchor,
    scale.IRIS_OT_meter,
    scale.IRIS_OT_exif_scale,
    scale.IRIS_OT_forget_scale,
    area_lamp.IRIS_OT_area_lamp,
    relight.IRIS_OT_hide_lights,
    relight.IRIS_OT_preview,
    compositing.IRIS_OT_match_photo,
    compositing.IRIS_OT_mix_lights,
    place.IRIS_OT_place,
    onto_photo.IRIS_OT_onto_photo,
    onto_plate.IRIS_OT_onto_plate,
    probe.IRIS_OT_probe,
    export.IRIS_OT_export,
    export.IRIS_OT_export_ies,
    export.IRIS_OT_export_camera,
    farm.IRIS_OT_export_farm,
    menus.IRIS_MT_object,
    photo_list.IRIS_UL_views,
    panels.IRIS_UL_lamps,
    panels.IRIS_PT_iris,
    panels.IRIS_PT_data,
    panels.IRIS_PT_check,
    panels.IRIS_PT_solve,
    panels.IRIS_PT_review,
    panels.IRIS_PT_relight,
    panels.IRIS_PT_insert,
    panels.IRIS_PT_export,
    wipe_line.IRIS_GT_wipe_line,
    wipe_line.IRIS_GGT_wipe,
)


def register() -> None:
    """Register everything with Blender."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.iris = bpy.props.PointerProperty(type=settings.IrisSettings)
    bpy.types.Camera.iris_exposure, bpy.types.Camera.iris_light_state = settings.EXPOSURE, settings.LIGHT_STATE
    icons.register()
    solve_preview.register()
    lamp_highlight.register()
    wipe.register()
    menus.register()
    run_job.register()


def unregister() -> None:
    """Stop all jobs and unregister everything."""
    run_job.unregister()
    menus.unregister()
    wipe.unregister()
    lamp_highlight.unregister()
    solve_preview.unregister()
    icons.unregister()
    del bpy.types.Scene.iris, bpy.types.Camera.iris_exposure, bpy.types.Camera.iris_light_state
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
