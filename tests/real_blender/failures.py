"""What goes wrong for people: processes killed, a disk that is full, a Python without torch, photos that are gone.

Each must end in a sentence in the panel, and no process may stay behind.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path

from .scenario import IMPORT_SECONDS, SOLVE_SECONDS, use_scene
from .session import Session, until
from .stage import Stage

GONE_SECONDS = 15.0
BLEND = "room.blend"


def worker_killed(stage: Stage) -> str:
    """kill -9 of the worker: the panel says so and what to do."""
    pid = start_solve(stage, fresh=True)
    os.kill(pid, signal.SIGKILL)
    until(lambda: state(stage) != "running", "the end is noticed", 10)
    found = stage.session.ask("job('solve')")
    assert found["state"] == "failed" and "kill" in found["what"] and found["fix"], found
    stage.session.scroll_to("iris.copy_error", columns=(0.3,))
    stage.photograph("20_worker_killed")
    return found["what"]


def file_loaded(stage: Stage) -> str:
    """Save, solve, load the file again: the solve goes on or is found again, and nothing crashes."""
    session = stage.session
    path = f"{session.root.HOME}/{BLEND}"
    session.ask("bpy.ops.wm.save_userpref()")  # otherwise done when Blender is closed, and it will be killed
    session.ask(f"bpy.ops.wm.save_as_mainfile(filepath={path!r})")
    pid = start_solve(stage)
    session.ask(f"bpy.ops.wm.open_mainfile(filepath={path!r})")
    until(lambda: stage.value("iris.views.keys()"), "the file is open again", 30)
    assert state(stage) == "running" and alive(pid), session.ask("job('solve')")
    return "the solve goes on"


def blender_killed(stage: Stage) -> str:
    """kill -9 of Blender during a solve: its worker ends by itself."""
    pid = stage.session.ask("job('solve')")["pid"]
    assert alive(pid)
    began = time.monotonic()
    stage.session.close()
    until(lambda: not alive(pid), "the worker ends when Blender is killed", GONE_SECONDS)
    return f"worker gone after {time.monotonic() - began:.1f} s"


def reopened(stage: Stage) -> str:
    """The .blend, opened in a new Blender, finds its job and goes on with it, though the cache of rays was deleted."""
    found = until(lambda: stage.session.ask("job('solve')"), "the job is found", 10)
    assert found["state"] == "interrupted" and found["fix"], found
    shutil.rmtree(stage.session.root.home / ".cache" / "iris")
    stage.show_sidebar()
    stage.photograph("21_reopened")
    stage.session.press("iris.solve")
    until(lambda: state(stage) not in ("running", "interrupted"), "the solve ends", SOLVE_SECONDS, 0.5)
    assert state(stage) == "done", stage.session.ask("job('solve')")
    return "interrupted, resumed, done"


def photo_missing(stage: Stage) -> str:
    """A photo of the capture deleted after the import: the check goes on without it and names it."""
    session = stage.session
    photo = host_path(session, stage.value("iris.capture")) / "train" / "Image" / "003_0001.png"
    kept = photo.read_bytes()
    photo.unlink()
    try:
        session.press("iris.check")
        until(lambda: session.ask("job('inspect')")["state"] not in ("running",), "the check ends", IMPORT_SECONDS)
        found = session.ask("job('inspect')")
        warnings = stage.value("iris.warnings")
        assert found["state"] == "done" and "003_0001" in warnings, (found, warnings)
        stage.photograph("22_photo_missing")
    finally:
        photo.write_bytes(kept)
    session.press("iris.check")
    until(lambda: "003_0001" in stage.value("iris.views.keys()"), "the photo is back", IMPORT_SECONDS)
    return next(line for line in warnings.splitlines() if "003_0001" in line)


def disk_full(stage: Stage) -> str:
    """A result folder on a disk that fills up: the panel says so; elsewhere the solve works as before."""
    session = stage.session
    kept = stage.value("iris.result")
    settings = "bpy.context.window_manager.windows[0].scene.iris"
    session.ask(f"setattr({settings}, 'result', '{session.root.SMALL_DISK}/result')")
    try:
        session.press("iris.solve")
        until(lambda: state(stage) not in ("missing", "running"), "the solve ends", SOLVE_SECONDS)
        found = session.ask("job('solve')")
        assert found["state"] == "failed" and "space" in found["what"] + found["fix"], found
        session.scroll_to("iris.copy_error", columns=(0.3,))
        stage.photograph("23_disk_full")
    finally:
        session.ask(f"setattr({settings}, 'result', {kept!r})")
    assert state(stage) == "done", session.ask("job('solve')")
    return found["what"]


def python_without_torch(stage: Stage) -> str:
    """A Python that has no torch: its test and a solve both say what is missing."""
    session = stage.session
    stage.open_preferences()
    stage.preferences_section("ADDONS")
    stage.set_solver("/usr/bin/python3")
    session.press("iris.test_python", "PREFERENCES", "WINDOW", 1, (0.3,))
    until(lambda: session.ask("job('test')")["state"] == "failed", "the test fails", 60)
    stage.photograph("24_no_torch")
    tested = session.ask("job('test')")
    assert tested["fix"], tested
    session.close_newest_window()
    session.press("iris.solve")
    until(lambda: state(stage) == "failed", "the solve fails", 60)
    found = session.ask("job('solve')")
    assert found["fix"], found
    return tested["what"]


def closed(stage: Stage) -> str:
    """Blender closed during a solve: it ends at once, with status 0, and its worker with it."""
    stage.session.ask(f"set_solver('{stage.session.root.REPOSITORY}/.venv/bin/python')")
    pid = start_solve(stage, fresh=True)
    began = time.monotonic()
    stage.session.ask("quit_soon()")
    code = stage.session.process.wait(30)
    until(lambda: not alive(pid), "the worker ends when Blender closes", GONE_SECONDS)
    assert code == 0, f"Blender ended with {code}"
    return f"{time.monotonic() - began:.1f} s"


def start_solve(stage: Stage, fresh: bool = False) -> int:
    """Press Solve and give the number of the worker, once it reports; ``fresh`` forgets what was solved before."""
    session = stage.session
    if fresh:
        shutil.rmtree(host_path(session, session.ask("job('solve')")["folder"]) / "checkpoints", ignore_errors=True)
    session.press("iris.solve")
    until(lambda: session.ask("job('solve')").get("stage"), "the worker reports", 120)
    return session.ask("job('solve')")["pid"]


def state(stage: Stage) -> str:
    """How the solve stands."""
    return stage.session.ask("job('solve')")["state"]


def host_path(session: Session, inside: str) -> Path:
    """A path of the artist's home, seen from this side."""
    return session.root.home / Path(inside).relative_to(session.root.HOME)


def alive(pid: int) -> bool:
    """Whether a process runs (one that ended and was not waited for does not)."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


BEFORE_KILL: tuple[Callable[[Stage], str], ...] = (worker_killed, file_loaded, blender_killed)
AFTER_KILL: tuple[Callable[[Stage], str], ...] = (
    reopened,
    disk_full,
    photo_missing,
    use_scene,
    python_without_torch,
    closed,
)
