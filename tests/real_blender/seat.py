"""``python -m tests.real_blender.seat [SUITE] [CAPTURE]``: what a room costs its artist, import to composite.

Per step: how often one presses, how long one waits, and how often and how long Blender stood still, of that in code of
the extension. CAPTURE is the folder of a capture with a transforms.json; the bundled room without it.
"""

from __future__ import annotations

import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .display import Display
from .root import REPOSITORY, set_up
from .scenario import open_tab
from .session import Session, until
from .stage import Stage

FREEZE_SECONDS = 0.5  # from which on one notices that Blender stands still
LONGEST_SECONDS = 1200.0
OUT = REPOSITORY / "out" / "seat"


@dataclass
class Counted:
    """Steps of one artist; each prints a row of a table."""

    stage: Stage
    presses: int = 0

    def __post_init__(self) -> None:
        click = self.stage.session.display.click

        def counted(x: float, y: float, times: int = 1, button: int = 1) -> None:
            self.presses += times
            click(x, y, times, button)

        self.stage.session.display.click = counted  # type: ignore[method-assign]

    def step(self, name: str, press: Callable[[], object], done: Callable[[], object] | None = None) -> None:
        """``press``, then wait until ``done``."""
        session, self.presses = self.stage.session, 0
        session.ask("monitor.take() and None")
        press()
        pressed = time.monotonic()
        if done is not None:
            until(done, name, LONGEST_SECONDS, 0.3)
        waited = time.monotonic() - pressed
        time.sleep(1.0)
        session.ask("None")
        taken = session.ask("monitor.take()")
        gaps = [gap for gap in taken["gaps"] if gap > FREEZE_SECONDS]
        calls = sorted((call for call in taken["calls"] if call[0] > FREEZE_SECONDS), reverse=True)
        ours = "; ".join(f"{seconds:.1f} s {where.rpartition('/')[2]}" for seconds, where in calls[:3])
        still = f"{len(gaps)}, {sum(gaps):.1f} s, longest {max(gaps):.1f} s" if gaps else "0"
        print(f"| {name} | {self.presses} | {waited:.0f} s | {still} | {ours or '-'} |", flush=True)
        self.stage.photograph(name.replace(" ", "_"))

    def job(self, name: str, button: str, kind: str) -> None:
        """A button that starts a job, and its end."""
        session = self.stage.session

        def ended() -> bool:
            return session.ask(f"job({kind!r})")["state"] not in ("missing", "running")

        session.scroll_to(button)
        self.step(name, lambda: session.press(button), ended)
        found = session.ask(f"job({kind!r})")
        assert found["state"] == "done", found


def work(stage: Stage, capture: Path | None) -> None:
    """Import, solve, apply, relight, insert, onto the photo."""
    session, counted = stage.session, Counted(stage)
    print("| step | presses | waiting | standing still | of that ours |\n|---|---|---|---|---|", flush=True)

    def views() -> object:
        return stage.value("iris.views.keys()")

    if capture is None:
        counted.step("import", lambda: session.press("iris.import_demo"), views)
    else:
        inside = f"{session.root.HOME}/{capture.name}"
        shutil.copytree(capture, session.root.home / capture.name)

        def browse() -> None:
            session.new_window(lambda: session.press("iris.import_capture"), "File View", (300, 150, 1000, 650))
            session.choose_file(f"{inside}/transforms.json")

        counted.step("import", browse, views)
    place = session.scroll_to("iris.preset", columns=(0.7,))
    session.display.wheel_with("ctrl", *place, -1)
    until(lambda: stage.value("iris.preset") == "draft", "the wheel sets the preset", 5)
    counted.job("solve", "iris.solve", "solve")
    session.scroll_to("iris.apply")
    counted.step("apply", lambda: session.press("iris.apply"), lambda: stage.value("get('iris_applied')"))

    def looks() -> None:
        for look in ("BLACKOUT", "PHOTOGRAPHED"):
            session.press(f"iris.look(look='{look}'", columns=(0.2, 0.6))

    session.scroll_to("iris.look", columns=(0.2, 0.6))
    counted.step("a look and back", looks)
    counted.step("preview", lambda: session.press("iris.preview"), lambda: time.sleep(5) or True)
    counted.step("preview off", lambda: session.press("iris.preview"))
    left, top, width, height = session.region("VIEW_3D", "WINDOW")
    middle = (left + 0.35 * width, top + 0.7 * height)
    session.scroll_to("iris.place", columns=(0.7, 0.8, 0.9))

    def insert() -> None:
        session.press("iris.place", columns=(0.7, 0.8, 0.9))
        session.display.move(*middle)
        session.display.click(*middle)

    counted.step("place a ball", insert)
    counted.job("onto photo", "iris.onto_photo", "composite")


def main() -> None:
    """Set up, install, and work."""
    suite = sys.argv[1] if len(sys.argv) > 1 else "trixie"
    # Leave through the with statements, so that no Blender and no X server stays behind.
    signal.signal(signal.SIGTERM, lambda *_ignored: sys.exit(128 + signal.SIGTERM))
    capture = Path(sys.argv[2]).resolve() if len(sys.argv) > 2 else None
    shutil.rmtree(OUT, ignore_errors=True)
    home = OUT / "home"
    home.mkdir(parents=True)
    root = set_up(suite, home, OUT / "set_up.log")
    target = ("--output-filepath", f"{root.HOME}/iris.zip")
    root.output("blender", "--command", "extension", "build", "--source-dir", root.REPOSITORY, *target)
    with Display(root, OUT / "xvfb.log") as display, Session(root, display, OUT / "blender.log") as session:
        stage = Stage(session, OUT)
        package = f"filepath='{root.HOME}/iris.zip', repo='user_default', enable_on_install=True"
        session.ask(f"bpy.ops.extensions.package_install_files({package}) and None")
        session.ask(f"set_solver('{root.REPOSITORY}/.venv/bin/python')")
        stage.open_every_section()
        open_tab(stage)
        work(stage, capture)


if __name__ == "__main__":
    main()
