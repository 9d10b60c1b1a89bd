"""The second half of what an artist does: a result onto the objects, other light, other things in the room."""

from __future__ import annotations

import time

import numpy as np

from .session import until
from .stage import ADD_X, Stage

LAMP_DIMMER = 0.98  # of the brightness with all lamps on
COMPOSITE_SECONDS = 400.0
WIPE_PIXELS = 95  # by which the slider is dragged
PREVIEW_SECONDS = 60.0
PREVIEW_GREY = 40.0  # of 255; a view that Cycles does not reach is black


def apply(stage: Stage) -> str:
    """Apply, undo, redo, apply again: undo restores the scene exactly, applying twice changes nothing."""
    session = stage.session
    before = session.ask("content()")
    session.press("iris.apply")
    until(lambda: stage.value("iris.lamps.keys()"), "the lamps are listed", 60)
    applied = session.ask("content()")
    stage.photograph("09_applied")
    stage.undo()
    assert session.ask("content()") == before, stage.difference(before)
    stage.redo()
    assert session.ask("content()") == applied, stage.difference(applied)
    session.press("iris.apply")
    assert session.ask("content()") == applied, stage.difference(applied)
    return f"{len(stage.value('iris.lamps.keys()'))} lamps"


def wipe(stage: Stage) -> str:
    """The wipe by its slider: the photo left of the line, in its own colors; right of it what the view showed before.
    Then the line itself is dragged, and the slider turns it off."""
    session = stage.session
    slider = session.scroll_to("iris.wipe", columns=(0.3,))
    before = _still(stage)
    left, right, rows = _frame(stage)
    session.display.drag(slider, (slider[0] + WIPE_PIXELS, slider[1]))
    share = until(lambda: stage.value("iris.wipe"), "the slider is dragged", 10)
    line = left + share * (right - left)
    ours, theirs = slice(int(left) + 4, int(line) - 4), slice(int(line) + 4, _last_column(stage, right))
    assert ours.stop - ours.start > 50 and theirs.stop - theirs.start > 20, "the frame is in view"
    until(lambda: np.abs(_screen(stage) - before)[rows, ours].mean() > 5, "the photo is drawn", 20)
    half = _still(stage)
    stage.photograph("10_wipe")
    shown, photo = half[rows, ours].mean((0, 1)) / 255, np.array(session.ask(f"photo_mean({share})"))
    assert np.abs(shown - photo).max() < 0.02, (shown, photo)
    changed = np.abs(half - before)[rows, theirs].mean()
    assert changed < 0.5, f"right of the line the view is another one by {changed:.2f}"
    height = 0.5 * (rows.start + rows.stop)
    target = left + 0.25 * (right - left)
    session.display.drag((line, height), (target, height))
    until(lambda: abs(stage.value("iris.wipe") - 0.25) < 0.02, "the line is dragged", 10)
    stage.photograph("10_wipe_dragged")
    session.ask("set_wipe(0.0)")
    until(lambda: np.abs(_screen(stage) - before)[rows, ours].mean() < 0.5, "the view is as it was", 20)
    return f"photo {photo.mean():.3f}, shown {shown.mean():.3f}; dragged to a quarter"


def preview(stage: Stage) -> str:
    """Preview: Cycles renders in the 3D view, beside the photo by the wipe; pressed again, the view is as it was."""
    session = stage.session
    place = session.scroll_to("iris.preview", columns=(0.5,))
    before = _still(stage)
    left, right, rows = _frame(stage)
    columns = slice(int(left) + 4, _last_column(stage, right))
    session.display.click(*place)
    until(lambda: np.abs(_screen(stage) - before)[rows, columns].mean() > 5, "the room is rendered", PREVIEW_SECONDS)
    until(lambda: _grey(_screen(stage)[rows, columns]) > PREVIEW_GREY, "the render is bright", PREVIEW_SECONDS)
    session.ask("set_wipe(0.5)")
    time.sleep(2.0)
    stage.photograph_at_once("10_preview")
    rendered = _grey(_screen(stage)[rows, int(0.5 * (left + right)) + 4 : columns.stop])
    session.ask("set_wipe(0.0)")
    session.press("iris.preview", columns=(0.5,))
    until(lambda: np.abs(_screen(stage) - before)[rows, columns].mean() < 1.0, "the view is as it was", 20)
    return f"grey {rendered:.0f} of 255"


def _screen(stage: Stage) -> np.ndarray:
    """(H, W, 3) the screen as it is, 0 to 255."""
    return np.asarray(stage.session.display.look().convert("RGB")).astype(float)


def _still(stage: Stage) -> np.ndarray:
    """(H, W, 3) the screen once the view has smoothed its edges and stands still, 0 to 255."""
    return np.asarray(stage.session.display.still().convert("RGB")).astype(float)


def _grey(pixels: np.ndarray) -> float:
    return float(pixels.mean())


def _frame(stage: Stage) -> tuple[float, float, slice]:
    """Left and right end of the camera's frame on the screen, and its rows."""
    session = stage.session
    left, top, _width, height = session.region("VIEW_3D", "WINDOW")
    corners = np.array(session.ask("camera_frame()")) * [1, -1] + [left, top + height]
    (x0, y0), (x1, y1) = corners.min(0), corners.max(0)
    return float(x0), float(x1), slice(int(y0) + 4, int(y1) - 4)


def _last_column(stage: Stage, right: float) -> int:
    """The last column of the frame that ends at ``right``, free of the sidebar and of the buttons beside it."""
    return int(min(right, stage.session.region("VIEW_3D", "UI")[0])) - 70


def switch_off(stage: Stage) -> str:
    """The brightest lamp off by its switch: the render gets darker."""
    session = stage.session
    bright = stage.render("10_all_lamps")
    lamps = stage.value("iris.lamps.keys()")
    visible = range(min(4, len(lamps)))  # rows of the list
    power = [stage.value(f"iris.lamps[{lamp}].strength") * stage.value(f"iris.lamps[{lamp}].area") for lamp in visible]
    number = max(visible, key=power.__getitem__)
    place = session.scroll_to(f"iris.lamps[{number}].on", columns=(0.05, 0.08, 0.11))
    session.display.click(*place)
    assert stage.value(f"iris.lamps[{number}].on") is False
    stage.photograph("11_lamp_off")
    dark = stage.render("12_lamp_off_render")
    assert sum(dark) < LAMP_DIMMER * sum(bright), (dark, bright)
    return f"{lamps[number]}: {sum(bright) / 3:.3f} to {sum(dark) / 3:.3f}"


def match_photo(stage: Stage) -> str:
    """Match Photo: the render through the recovered camera is another one; switched off, nothing is left of it."""
    session = stage.session
    before = session.ask("content()")
    plain = stage.render("12_not_matched")
    session.press("iris.match_photo")
    until(lambda: stage.value("get('iris_matched')"), "the camera is in the compositing", 20)
    matched = stage.render("12_matched")
    assert max(abs(a - b) for a, b in zip(plain, matched, strict=True)) > 0.01, (plain, matched)
    session.press("iris.match_photo")
    assert session.ask("content()") == before, stage.difference(before)
    return f"{sum(plain) / 3:.3f} to {sum(matched) / 3:.3f}"


def add_object(stage: Stage) -> str:
    """Add > Mesh > first entry, then render it in the room's light."""
    session = stage.session
    count = len(session.ask("bpy.data.objects.keys()"))
    left, top, _width, _height = session.region("VIEW_3D", "HEADER")
    menu_left, menu_top, menu_right, _bottom = session.menu(left + ADD_X, top + 13)
    session.display.click((menu_left + menu_right) / 2, menu_top + 14)
    session.display.still()
    session.display.click(menu_right + 60, menu_top + 14)
    until(lambda: len(session.ask("bpy.data.objects.keys()")) > count, "an object is added", 20)
    stage.photograph("13_object")
    stage.render("14_object_render")
    return session.ask("bpy.context.window_manager.windows[0].view_layer.objects.active.name")


def place_object(stage: Stage) -> str:
    """Place, over the room, larger by the wheel, a click; then once more, and Esc: nothing is left of that."""
    session = stage.session
    left, top, width, height = session.region("VIEW_3D", "WINDOW")
    middle = (left + 0.35 * width, top + 0.7 * height)
    before = session.ask("sorted(bpy.data.objects.keys())")

    def carry() -> None:
        session.press("iris.place", columns=(0.7, 0.8, 0.9))
        until(lambda: not session.ask("takes_steps()"), "the room is read", 20)
        session.display.move(*middle)
        session.display.scroll(*middle, -3)

    carry()
    stage.photograph("15_placing")
    session.display.click(*middle)
    until(lambda: len(session.ask("bpy.data.objects.keys()")) == len(before) + 2, "an object is placed", 20)
    stage.photograph("16_placed")
    placed = sorted(set(session.ask("bpy.data.objects.keys()")) - set(before))
    size = session.ask(f"max(bpy.data.objects[{placed[-1]!r}].dimensions)")
    assert abs(size - 0.3 * 1.1**3) < 0.01, size
    now = session.ask("content()")
    carry()
    session.display.keys("Escape")
    until(lambda: session.ask("content()") == now, "nothing is left of what was taken back", 20)
    return f"{placed[0]}, {size:.2f} m wide"


def onto_photo(stage: Stage) -> str:
    """What was placed, onto the photo that is looked at: another Blender renders it, the picture lies over the view."""
    session = stage.session
    session.press("iris.onto_photo")
    stage.photograph_at_once("17_onto_photo_runs")
    until(
        lambda: session.ask("job('composite')")["state"] not in ("missing", "running"), "the picture", COMPOSITE_SECONDS
    )
    found = session.ask("job('composite')")
    assert found["state"] == "done", found
    stage.photograph("17_onto_photo")
    (name,) = session.ask("[i.name for i in bpy.data.images if i.name.startswith('IRIS Onto')]")
    return name


def mix_lights(stage: Stage) -> str:
    """Mix Lights: a slider per light; the render is what it was, and switched off nothing is left of it."""
    session = stage.session
    before = session.ask("content()")
    plain, editors = stage.render("18_not_mixed"), stage.editors()
    count = session.windows()
    session.press("iris.mix_lights")
    until(lambda: stage.value("get('iris_mixed')"), "the lights are mixed", 20)
    until(lambda: session.windows() > count, "the compositor has a window", 20)
    stage.photograph("18_compositor")
    assert stage.editors() == editors, f"{editors} became {stage.editors()}"
    session.close_newest_window()
    mixed = stage.render("18_mixed")
    stage.photograph("18_sliders")
    assert max(abs(a - b) for a, b in zip(plain, mixed, strict=True)) < 0.02, (plain, mixed)
    session.press("iris.mix_lights")
    assert session.ask("content()") == before, stage.difference(before)
    return f"{sum(plain) / 3:.3f} and {sum(mixed) / 3:.3f}"
