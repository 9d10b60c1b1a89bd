"""Inside Blender: tells the test where things are and what state they are in. It presses nothing itself.

``blender -P driver.py -- FOLDER``: listens on a local port, written to FOLDER/port. A request is a line with a JSON
string, a Python expression over this file's names; the answer is a line with {"value": …} or {"error": …}.
"""

from __future__ import annotations

import json
import socket
import sys
import time
import traceback
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from monitor import Monitor  # beside this file, which Blender runs as a script

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
TICK_SECONDS = 0.005
ADDON = "bl_ext.user_default.iris"
monitor = Monitor(str(Path(bpy.utils.user_resource("EXTENSIONS")) / "user_default" / "iris"))


def windows() -> list[dict]:
    """Every window with its areas and regions, in pixels; y upwards from the lower left corner as Blender counts."""

    def box(thing: object) -> dict:
        return {name: getattr(thing, name) for name in ("x", "y", "width", "height")}

    return [
        box(window)
        | {
            "areas": [
                box(area) | {"type": area.type, "regions": [box(part) | {"type": part.type} for part in area.regions]}
                for area in window.screen.areas
            ]
        }
        for window in bpy.context.window_manager.windows
    ]


def hovered(window: int, x: int, y: int, height: int) -> str:
    """What the mouse is over in a window: an operator as its Python call, a property as its data path, else empty.

    The point is counted from the top left corner of the screen, which is ``height`` high. Blender tells what is there
    to the commands behind "Copy Python Command" and "Copy Data Path"; a property of the preferences has no path and is
    called "property".
    """
    manager = bpy.context.window_manager
    where = manager.windows[window]
    x, y = x - where.x, height - 1 - y - where.y
    for area in where.screen.areas:
        for region in sorted(area.regions, key=lambda region: region.type == "WINDOW"):
            inside = region.x <= x < region.x + region.width and region.y <= y < region.y + region.height
            if inside and region.width > 1 and region.height > 1:
                with bpy.context.temp_override(window=where, area=area, region=region):
                    return _button()
    return ""


def _button() -> str:
    of_button = bpy.ops.ui
    if of_button.copy_python_command_button.poll() and of_button.copy_python_command_button() == {"FINISHED"}:
        return bpy.context.window_manager.clipboard.replace('"', "'")
    if of_button.copy_data_path_button.poll():
        for full in (True, False):
            if of_button.copy_data_path_button(full_path=full) == {"FINISHED"}:
                return bpy.context.window_manager.clipboard
    return "property" if of_button.reset_default_button.poll() else ""


def sidebar_tab() -> str:
    """Tab at which the 3D view's sidebar is open; empty where it is closed or not yet drawn."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type == "VIEW_3D" and area.spaces.active.show_region_ui:
            region = next(part for part in area.regions if part.type == "UI")
            return region.active_panel_category if region.width > 1 else ""
    return ""


def camera_frame() -> list[list[float]]:
    """Corners of the camera's frame in the first 3D view, from the bottom left on, in its pixels; y upwards."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(part for part in area.regions if part.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return [list(corner) for corner in sys.modules[f"{ADDON}.operators.ui.wipe"].camera_frame(bpy.context)]


def set_wipe(share: float) -> None:
    """What dragging the slider does."""
    bpy.context.window_manager.windows[0].scene.iris.wipe = share


def photo_mean(share: float) -> list[float]:
    """Mean of each channel, as it is displayed, of the left ``share`` of the active camera's photo."""
    image = bpy.context.window_manager.windows[0].scene.camera.data.background_images[0].image
    width, height = image.size
    pixels, wide = list(image.pixels), int(share * width)
    rows = [pixels[4 * width * row : 4 * (width * row + wide)] for row in range(height)]
    return [sum(sum(row[channel::4]) for row in rows) / (wide * height) for channel in range(3)]


def show_clip(path: str) -> None:
    """What adding a movie clip to the active camera's backgrounds does; the scene is its one frame long."""
    scene = bpy.context.window_manager.windows[0].scene
    behind = scene.camera.data.background_images.new()
    behind.source, behind.clip = "MOVIE_CLIP", bpy.data.movieclips.load(path)
    scene.frame_start = scene.frame_end = 1


def job(name: str) -> dict:
    """How a job of the scene stands: state, what is wrong, its fix; process, stage and share done while it runs."""
    jobs = sys.modules[f"{ADDON}.iris_addon.blender.worker.jobs"]
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        folder = sys.modules[f"{ADDON}.operators.folders"].job_folder(name, bpy.context)
    record, running = jobs.record(name, folder), jobs.running(name, folder)
    found = {"state": record.state, "what": record.what, "fix": record.fix, "folder": str(folder)}
    if running is not None:
        worker = running.worker
        found |= {"pid": worker.pid, "stage": worker.stage, "overall": worker.overall}
    return found


def takes_steps() -> bool:
    """Whether an operator of the extension is at work between redraws."""
    return sys.modules[f"{ADDON}.operators.modal_steps"].busy()


def close_newest_window() -> None:
    """What the cross of its frame would do, which a server without a window manager does not have."""
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):
        bpy.ops.wm.window_close()


def set_solver(python: str) -> None:
    """What typing it into the preferences does."""
    bpy.context.preferences.addons[ADDON].preferences.python = python


def quit_soon() -> None:
    """Close Blender after this answer; nobody is asked whether to save."""

    def leave() -> None:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.wm.quit_blender()

    bpy.app.timers.register(leave, first_interval=0.2)


def content() -> dict:
    """What the file holds: names by kind, the materials of each object, and what its meshes look like."""
    kinds = ("objects", "meshes", "materials", "images", "worlds", "collections", "lights", "cameras", "texts")
    found = {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in kinds}
    for thing in bpy.data.objects:
        if thing.type == "MESH":
            layers = sorted(layer.name for layer in thing.data.uv_layers)
            slots = [slot.material.name if slot.material else "" for slot in thing.material_slots]
            found[thing.name] = [thing.data.name, len(thing.data.polygons), layers, slots]
    return found


def small_render() -> None:
    """Cycles, few samples: seconds instead of minutes."""
    for scene in bpy.data.scenes:
        scene.render.engine = "CYCLES"
        scene.cycles.samples = 8
        scene.cycles.use_denoising = False
        scene.render.threads_mode, scene.render.threads = "FIXED", 2


def rendered(path: str) -> list[float]:
    """Mean of each channel of the last render, which is saved to a file as well."""
    image = bpy.data.images["Render Result"]
    image.save_render(path)
    back = bpy.data.images.load(path)
    try:
        pixels = list(back.pixels)
        return [sum(pixels[channel::4]) / (len(pixels) // 4) for channel in range(3)]
    finally:
        bpy.data.images.remove(back)


class Server:
    """One connection at a time, served from a timer on Blender's main thread."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._pending = b""
        part = FOLDER / "port.part"
        part.write_text(str(self._listener.getsockname()[1]))
        part.rename(FOLDER / "port")

    def tick(self) -> float:
        """Note the time, answer what was asked."""
        monitor.tick()
        if self._client is None:
            try:
                self._client = self._listener.accept()[0]
            except BlockingIOError:
                return TICK_SECONDS
            self._client.setblocking(False)
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return TICK_SECONDS
        if not data:
            self._client, self._pending = None, b""
            return TICK_SECONDS
        *lines, self._pending = (self._pending + data).split(b"\n")
        for line in lines:
            answer = json.dumps(self._answer(json.loads(line)), default=str).encode() + b"\n"
            self._client.setblocking(True)
            self._client.sendall(answer)
            self._client.setblocking(False)
        return TICK_SECONDS

    @staticmethod
    def _answer(expression: str) -> dict:
        try:
            return {"value": eval(expression, globals())}
        except Exception:
            return {"error": traceback.format_exc()}


def main() -> None:
    """Make Blender quiet and start serving."""
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.show_tooltips = False  # they would cover what is photographed
    bpy.context.preferences.inputs.use_mouse_continuous = False  # a dragged slider would take the mouse back
    bpy.context.preferences.filepaths.save_version = 0
    monitor.start()
    bpy.app.timers.register(Server().tick, first_interval=0.5, persistent=True)
    print(f"driver ready after {time.process_time():.1f} s", flush=True)


main()
