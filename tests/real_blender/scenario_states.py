"""What a new artist does without a solver: the solved demo, a room of two light states, a farm job, a plate, by mouse.

The room of two states is the solved demo with what a solve of such photos would add to it (:func:`make_room`): another
light state, a lamp with a profile, and half of the photos by a second camera.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from iris_addon.model.device import Device
from iris_addon.model.lamp_profile import LampProfile
from iris_addon.model.recovered import LightState
from iris_addon.model.response import gamma
from iris_addon.results.folder import load_result

from .root import REPOSITORY
from .scenario import open_tab
from .scenario_relight import COMPOSITE_SECONDS
from .session import until
from .stage import Stage

SOLVED = REPOSITORY / "assets" / "demo_solved"
PHOTOS = REPOSITORY / "assets" / "demo_room" / "train" / "Image"
ALL_ON, BEDSIDE = "All lamps", "Bedside"
SPOT = LampProfile.of(np.array([1.0, 0.85, 0.45, 0.12, 0.03, 0.01]))
DARKER = 0.8
"""The render in the second state over that in the first, at most: two of three lamps are off."""


def make_room(folder: Path) -> None:
    """Write the room of two states as a result folder."""
    solved = load_result(SOLVED)
    first, *others = solved.emitters
    radiance = np.array([emitter.radiance for emitter in solved.emitters])
    photos = tuple(solved.exposures)
    half = len(photos) // 2
    bedside = radiance * np.array([[0.0], [1.0], [0.0]])
    made = replace(
        solved,
        emitters=(replace(first, profile=SPOT), *others),
        light_states=(LightState(ALL_ON, photos[:half], radiance), LightState(BEDSIDE, photos[half:], bedside)),
        devices=(Device("Second Camera", gamma(0.3), photos=photos[half:]),),
    )
    made.save(folder)
    shutil.copytree(SOLVED / "report", folder / "report", dirs_exist_ok=True)


def open_demo(stage: Stage) -> str:
    """One press, without a solver: photos, room and lamps are there."""
    session = stage.session
    session.press("iris.open_demo")
    until(lambda: stage.value("iris.lamps.keys()"), "the lamps are listed", 60)
    stage.photograph("30_open_demo")
    return f"{len(stage.value('iris.lamps.keys()'))} lamps"


def apply_states(stage: Stage) -> str:
    """The folder of the room of two states typed into Result, and Apply: each state is a look."""
    session = stage.session
    make_room(session.root.home / "two_states")
    session.type_into(session.scroll_to("iris.result", columns=(0.6,)), f"{session.root.HOME}/two_states")
    session.press("iris.apply")
    looks = "list(bpy.context.window_manager.windows[0].scene.get('iris_looks', {}).keys())"
    until(lambda: session.ask(looks) == [ALL_ON, BEDSIDE], "the states are looks", 60)
    session.scroll_to("iris.own_look", columns=(0.2, 0.6))
    stage.photograph("31_states_applied")
    return ", ".join(session.ask(looks))


def press_states(stage: Stage) -> str:
    """Each state by its button: the lamps are on that were, and the render gets darker."""
    session = stage.session
    shine, means = {}, {}
    for name in (BEDSIDE, ALL_ON):
        session.press(f"iris.own_look(name='{name}'", columns=(0.2, 0.6))
        stage.photograph(f"32_look_{name.split()[0].lower()}")
        shine[name] = session.ask("sorted(lamp.on for lamp in bpy.data.scenes[0].iris.lamps)")
        means[name] = sum(stage.render(f"33_render_{name.split()[0].lower()}"))
    assert shine == {BEDSIDE: [False, False, True], ALL_ON: [True, True, True]}, shine
    assert means[BEDSIDE] < DARKER * means[ALL_ON], means
    return f"{means[ALL_ON] / 3:.3f} and {means[BEDSIDE] / 3:.3f}"


def choose_spot(stage: Stage) -> str:
    """The lamp with the profile chosen in the list: its beam stands below."""
    session = stage.session
    index = session.ask(
        "next(k for k, lamp in enumerate(bpy.data.scenes[0].iris.lamps) if lamp.material['iris_lamp'] == 0)"
    )
    x, y = session.scroll_to(f"iris.lamps[{index}].on", columns=(0.05, 0.08, 0.11))
    session.display.click(x + 55, y)
    until(lambda: stage.value("iris.lamp_index") == index, "the lamp is chosen", 10)
    session.display.scroll(x, y + 120, 3)
    stage.photograph("34_spot")
    return str(stage.value("iris.lamps.keys()")[index])


def two_responses(stage: Stage) -> str:
    """Response of a photo of each camera: another curve, which its photo names."""
    session = stage.session
    curves = []
    for index in (0, len(stage.value("iris.views.keys()")) - 1):
        session.ask(f"setattr(bpy.data.scenes[0].iris, 'view_index', {index})")
        columns = (0.15, 0.4, 0.6, 0.85)
        stage.press_for_window("iris.review(kind='curve'", "Image Editor", f"35_response_{index}", columns)
        curves.append(session.ask("list(next(i for i in bpy.data.images if 'esponse' in i.name).pixels)"))
    moved = np.abs(np.subtract(*curves)).mean()
    assert moved > 1e-3, "both photos have one curve"
    return f"differ by {moved:.3f}"


def farm_job(stage: Stage) -> str:
    """Export Farm Job into a folder: the bundle is written."""
    session = stage.session
    bundle = session.root.home / "bundle"
    bundle.mkdir(exist_ok=True)
    session.ask("setattr(bpy.data.scenes[0].iris, 'open_export', True)")  # what a click on its heading does
    session.new_window(lambda: session.press("iris.export_farm"), "File View", (300, 150, 1000, 650))
    session.choose_folder(f"{session.root.HOME}/{bundle.name}", lambda: stage.photograph("36_farm_browser"))
    until(lambda: session.ask("job('farm')")["state"] not in ("missing", "running"), "the bundle is written", 120)
    stage.photograph("37_farm_done")
    found = session.ask("job('farm')")
    assert found["state"] == "done", found
    written = sorted(path.name for path in bundle.iterdir())
    assert "template.json" in written, written
    return f"{len(written)} files"


def onto_clip(stage: Stage) -> str:
    """Put Onto Plate with a movie clip behind the camera: its frame is there."""
    session = stage.session
    plate, frames = session.root.home / "plate", session.root.home / "frames"
    for folder in (plate, frames):
        folder.mkdir(exist_ok=True)
    view = stage.value("iris.views.keys()")[stage.value("iris.view_index")]
    shutil.copyfile(PHOTOS / f"{view}.png", plate / "plate_0001.png")
    session.ask(f"show_clip('{session.root.HOME}/plate/plate_0001.png')")
    session.new_window(lambda: session.press("iris.onto_plate"), "File View", (300, 150, 1000, 650))
    session.choose_folder(f"{session.root.HOME}/{frames.name}", lambda: stage.photograph("38_plate_browser"))
    until(lambda: session.ask("job('plate')")["state"] != "missing", "it starts", 30)
    stage.photograph_at_once("39_plate_runs")
    until(lambda: session.ask("job('plate')")["state"] != "running", "the frame", COMPOSITE_SECONDS)
    found = session.ask("job('plate')")
    assert found["state"] == "done", found
    stage.photograph("40_plate_done")
    with Image.open(frames / "frame_0001.png") as made, Image.open(plate / "plate_0001.png") as photo:
        assert made.size == photo.size, (made.size, photo.size)
        off = np.abs(np.asarray(made.convert("RGB"), float) - np.asarray(photo.convert("RGB"), float)).mean()
    assert off < 1.0, f"nothing was added, and the plate is another one by {off:.2f}"
    return f"frame differs from its plate by {off:.2f} of 255"


STEPS: tuple[Callable[[Stage], str], ...] = (
    open_tab,
    open_demo,
    apply_states,
    press_states,
    choose_spot,
    two_responses,
    farm_job,
    onto_clip,
)
