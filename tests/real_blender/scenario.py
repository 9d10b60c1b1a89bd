"""What an artist does, from the built zip to a relit render, by mouse. Each step leaves a picture."""

from __future__ import annotations

import time
from collections.abc import Callable

from .scenario_relight import (
    add_object,
    apply,
    match_photo,
    mix_lights,
    onto_photo,
    place_object,
    preview,
    switch_off,
    wipe,
)
from .session import MARGIN_PIXELS, PAGE_NOTCHES, until
from .stage import ADDON, Stage

SOLVE_SECONDS = 400.0
IMPORT_SECONDS = 120.0
CANCEL_SECONDS = 1.0


# ---- install ---------------------------------------------------------------------------------------------------------


def install(stage: Stage) -> str:
    """Edit > Preferences > Get Extensions > Install from Disk."""
    session = stage.session
    stage.open_preferences()
    stage.preferences_section("EXTENSIONS")
    left, top, width, _height = session.region("PREFERENCES", "WINDOW", 1)
    session.new_window(lambda: session.choose(left + width - 22, top + 18, -1), "File View", (300, 150, 1000, 650))
    session.choose_file(f"{session.root.HOME}/iris.zip", lambda: stage.photograph("01_install"))
    until(lambda: session.ask(f"{ADDON!r} in bpy.context.preferences.addons"), "the extension is enabled", 60)
    stage.open_every_section()
    return "enabled"


def choose_solver(stage: Stage) -> str:
    """Preferences > Add-ons > IRIS: the solver's Python, and its test."""
    session = stage.session
    stage.preferences_section("ADDONS")
    stage.set_solver(f"{session.root.REPOSITORY}/.venv/bin/python")
    session.press("iris.test_python", "PREFERENCES", "WINDOW", 1, (0.3,))
    until(lambda: session.ask("job('test')")["state"] not in ("missing", "running"), "the Python is tested", 120)
    stage.photograph("02_preferences")
    found = session.ask("job('test')")
    assert found["state"] == "done", found
    session.close_newest_window()
    return "tested"


# ---- import and check ------------------------------------------------------------------------------------------------


def open_tab(stage: Stage) -> str:
    """The sidebar, as wide as it opens, and its tab IRIS."""
    session = stage.session
    left, top, width, height = session.region("VIEW_3D", "WINDOW")
    session.display.move(left + width / 2, top + height / 2)
    session.display.keys("n")
    until(lambda: session.ask("sidebar_tab()"), "the sidebar opens", 20)
    session.display.still()
    left, top, width, height = session.region("VIEW_3D", "UI")
    for y in range(top + 20, top + height, 25):
        if session.ask("sidebar_tab()") == "IRIS":
            stage.photograph("03_tab")
            return f"{session.region('VIEW_3D', 'UI')[2]} pixels wide"
        session.display.click(left + width - 8, y)
    raise AssertionError("no tab IRIS")


def import_capture(stage: Stage) -> str:
    """The bundled room, by its button."""
    session = stage.session
    session.press("iris.import_demo")
    until(lambda: stage.value("iris.views.keys()"), "the capture is imported", IMPORT_SECONDS)
    assert session.ask("job('inspect')")["state"] == "done", session.ask("job('inspect')")
    stage.hide_the_cube()
    stage.photograph("04_import")
    return f"{len(stage.value('iris.views.keys()'))} photos"


def check(stage: Stage) -> str:
    """Photo over mesh: the next photo."""
    before = stage.value("iris.view_index")
    stage.session.press("step_photo(by=1)", columns=(0.85, 0.9))
    assert stage.value("iris.view_index") == before + 1
    stage.photograph("05_check")
    warnings = stage.value("iris.warnings").splitlines()
    return f"{len(warnings)} warnings"


# ---- solve -----------------------------------------------------------------------------------------------------------


def solve(stage: Stage) -> str:
    """Preset draft by the wheel, Solve, the bar moves, Cancel ends the worker within a second."""
    session = stage.session
    place = session.scroll_to("iris.preset", columns=(0.7,))
    session.display.wheel_with("ctrl", *place, -1)
    until(lambda: stage.value("iris.preset") == "draft", "the wheel sets the preset", 5)
    session.press("iris.solve")
    until(lambda: session.ask("job('solve')").get("overall", 0) > 0.02, "the bar moves", SOLVE_SECONDS)
    first = session.ask("job('solve')")["overall"]
    place = session.scroll_to("iris.cancel", columns=(0.3,))
    until(lambda: session.ask("job('solve')").get("overall", 0) > first, "the bar moves on", SOLVE_SECONDS)
    stage.photograph_at_once("06_solving")
    session.display.click(*place)
    began = time.monotonic()
    until(lambda: session.ask("job('solve')")["state"] == "cancelled", "the solve is cancelled", 10, 0.02)
    seconds = time.monotonic() - began
    stage.photograph("07_cancelled")
    assert seconds < CANCEL_SECONDS + 0.5, f"cancelling took {seconds:.1f} s"
    return f"cancelled at {first:.0%}, in {seconds:.2f} s after the click"


def resume(stage: Stage) -> str:
    """Resume to the end; meanwhile the interface is watched, and the room seen in the preview."""
    session = stage.session
    stage.idle_gaps()
    session.press("iris.solve")
    session.ask("monitor.take() and None")
    seen, previewed = [], False

    def through() -> bool:
        nonlocal previewed
        found = session.ask("job('solve')")
        seen.append(found.get("overall", 0.0))
        if found.get("stage") in ("materials", "textures") and not previewed:
            _x, y = session.scroll_to("iris.preview", columns=(0.2, 0.3))
            session.display.scroll(session.region("VIEW_3D", "UI")[0] + MARGIN_PIXELS, y, PAGE_NOTCHES)
            time.sleep(1.0)
            stage.photograph_at_once("07_preview")
            previewed = True
        return found["state"] not in ("running",)

    until(through, "the solve ends", SOLVE_SECONDS, 0.2)
    found = session.ask("job('solve')")
    assert found["state"] == "done", found
    assert len(set(seen)) > 5, f"the bar stood still: {sorted(set(seen))}"
    assert previewed, "no preview was shown"
    stage.judge_gaps()
    return f"{len(set(seen))} positions of the bar"


def review(stage: Stage) -> str:
    """Photo, re-render and error over the view, each with its button pressed, and the response in a window."""
    session = stage.session
    columns = (0.15, 0.4, 0.6, 0.85)
    for kind in ("render", "error", "photo"):
        session.press(f"iris.review(kind='{kind}'", columns=columns)
        stage.photograph(f"08_review_{kind}")
    stage.press_for_window("iris.review(kind='curve'", "Image Editor", "08_review_curve", columns)
    images = session.ask("[i.name for i in bpy.data.images]")
    return f"{len(images)} images"


# ---- the end -------------------------------------------------------------------------------------------------------


def enable_again(stage: Stage) -> str:
    """Disable and enable by the box in the preferences: nothing is left, then everything is back."""
    session = stage.session
    stage.open_preferences()
    stage.preferences_section("ADDONS")
    for verb in ("disable", "enable", "disable", "enable"):
        session.press(f"addon_{verb}(module='{ADDON}')", "PREFERENCES", "WINDOW", 1, (0.03, 0.04, 0.05))
        here = session.ask("hasattr(bpy.types.Scene, 'iris')")
        assert here is (verb == "enable"), f"after {verb}: {here}"
        left = session.ask("[n for n in dir(bpy.types) if n.startswith('IRIS_')] + dir(bpy.ops.iris)")
        assert bool(left) is (verb == "enable"), f"after {verb}: {left}"
    session.close_newest_window()
    # Blender forgets an extension's preferences when it is disabled.
    session.ask(f"set_solver('{session.root.REPOSITORY}/.venv/bin/python')")
    stage.open_every_section()
    return "twice"


def use_scene(stage: Stage) -> str:
    """In a Blender of its own: Restore Originals, then Use This Scene; room and cameras become a capture."""
    session = stage.session
    photos = stage.value("iris.views.keys()")
    session.press("iris.restore")
    session.press("iris.use_scene")
    until(lambda: stage.value("iris.source") == "SCENE", "the scene is the source", 20)
    until(lambda: session.ask("job('inspect')")["state"] != "running", "the scene is checked", IMPORT_SECONDS)
    assert session.ask("job('inspect')")["state"] == "done", session.ask("job('inspect')")
    until(lambda: stage.value("iris.views.keys()"), "the photos are listed", 20)
    assert len(stage.value("iris.views.keys()")) == len(photos)
    session.type_into(session.scroll_to("iris_light_state", columns=(0.6,)), "evening")
    until(lambda: stage.value("camera.data.iris_light_state") == "evening", "the light state is typed", 10)
    stage.photograph("19_use_scene")
    session.ask("setattr(bpy.context.window_manager.windows[0].scene.camera.data, 'iris_light_state', '')")
    return f"{len(photos)} photos, {len(stage.value('iris.warnings').splitlines())} warnings"


STEPS: tuple[Callable[[Stage], str], ...] = (
    install,
    choose_solver,
    open_tab,
    import_capture,
    check,
    solve,
    resume,
    review,
    apply,
    wipe,
    preview,
    switch_off,
    match_photo,
    add_object,
    place_object,
    onto_photo,
    mix_lights,
    enable_again,
)
