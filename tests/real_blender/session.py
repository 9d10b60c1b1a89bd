"""One Blender with a window: started, asked, clicked, photographed, ended."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from .display import HEIGHT, WIDTH, Display
from .root import Root

START_SECONDS = 180.0
ANSWER_SECONDS = 180.0
ROW_PIXELS = 12  # a button is 20 high
PAGES = 7  # of the sidebar with every step open, and more
EDGE_PIXELS = 12  # at the lower edge, where buttons are cut off and a press would drag the edge
MARGIN_PIXELS = 5  # left of every list, which would take the wheel for itself
PAGE_NOTCHES = 8  # of the mouse wheel


class Session:
    """A running Blender.

    Args:
        log: file for what it prints; warnings are looked for there.
        blend: a file to open, as a path inside.
    """

    def __init__(self, root: Root, display: Display, log: Path, blend: str | None = None) -> None:
        self.display, self.root, self.log = display, root, log
        port = root.home / ".driver" / "port"
        port.parent.mkdir(exist_ok=True)
        port.unlink(missing_ok=True)
        environment = root.environment(DISPLAY=display.name, LIBGL_ALWAYS_SOFTWARE="1")
        arguments = ["blender", "-p", "0", "0", str(WIDTH), str(HEIGHT), *([blend] if blend else [])]
        driver = ("-P", f"{root.REPOSITORY}/tests/real_blender/driver.py", "--", f"{root.HOME}/.driver")
        self._log = log.open("w")
        self.process = subprocess.Popen(
            root.command(*arguments, *driver),
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        self._socket: socket.socket | None = None
        self._last_y = 0
        try:
            until(lambda: port.exists() or not self.running, "Blender starts", START_SECONDS)
            assert self.running, f"Blender ended at its start: {log.read_text()}"
            self._socket = socket.create_connection(("127.0.0.1", int(port.read_text())), ANSWER_SECONDS)
            self._lines = self._socket.makefile("r")
            display.settle = self.settle
            display.still()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Session:
        return self

    def __exit__(self, _kind: type | None, _error: BaseException | None, _trace: TracebackType | None) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """Whether Blender lives."""
        return self.process.poll() is None

    def settle(self) -> None:
        """Wait until Blender has taken what mouse and keys did: its main loop reads events, then answers, then handles
        them, so that the third answer comes after everything that was handled in between was drawn, too."""
        for _ in range(3):
            self.ask("None")

    def close(self) -> None:
        """End Blender without ceremony, if it still runs."""
        self.display.settle = lambda: time.sleep(0.2)
        if self._socket is not None:
            self._socket.close()
        if self.running:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self._log.close()

    def ask(self, expression: str) -> Any:
        """Value of an expression inside Blender (``bpy`` and the names of driver.py)."""
        assert self._socket is not None
        self._socket.sendall(json.dumps(expression).encode() + b"\n")
        line = self._lines.readline()
        assert line, f"Blender ended while asked {expression}: {self.log.read_text()[-3000:]}"
        answer = json.loads(line)
        assert "error" not in answer, f"{expression}:\n{answer.get('error')}"
        return answer["value"]

    # ---- where things are --------------------------------------------------------------------------------------------

    def windows(self) -> int:
        """How many windows are open."""
        return self.ask("len(bpy.context.window_manager.windows)")

    def region(self, area: str, region: str, window: int = 0) -> tuple[int, int, int, int]:
        """Rectangle (left, top, width, height) on the screen of a region of the first area of its kind."""
        box = self.ask("windows()")[window]
        for candidate in box["areas"]:
            for part in candidate["regions"]:
                if candidate["type"] == area and part["type"] == region and part["width"] > 1 and part["height"] > 1:
                    top = HEIGHT - (box["y"] + part["y"] + part["height"])
                    return box["x"] + part["x"], top, part["width"], part["height"]
        raise AssertionError(f"no region {region} of {area} in {box}")

    def hovered(self, x: float, y: float, window: int = 0) -> str:
        """Operator or property that the mouse is over once it is at that point of the screen."""
        self.display.move(x, y)
        return self.ask(f"hovered({window}, {x:.0f}, {y:.0f}, {HEIGHT})")

    def find(
        self, name: str, area: str, region: str, window: int = 0, columns: Sequence[float] = (0.5,)
    ) -> tuple[float, float] | None:
        """Middle of the first button whose operator or property contains ``name``, along vertical lines (shares of the
        width) through what is visible of a region; None where there is none."""
        left, top, width, height = self.region(area, region, window)
        rows = range(top + 4, top + height - EDGE_PIXELS, ROW_PIXELS)
        # What comes next is mostly just below what came last.
        ahead = sorted(rows, key=lambda y: (y < self._last_y - 2 * ROW_PIXELS, y))
        for y in ahead:
            for x in (left + column * width for column in columns):
                if name in self.hovered(x, y, window):
                    around = range(y - 12, min(y + 22, top + height - EDGE_PIXELS), 4)
                    hits = [near for near in around if name in self.hovered(x, near, window)] or [y]
                    self._last_y = hits[len(hits) // 2]
                    return x, self._last_y
        return None

    # ---- what a person does ------------------------------------------------------------------------------------------

    def press(
        self, name: str, area: str = "VIEW_3D", region: str = "UI", window: int = 0, columns: Sequence[float] = (0.5,)
    ) -> tuple[float, float]:
        """Click the button of that operator or property, scrolling for it if need be; where it was."""
        place = self.scroll_to(name, area, region, window, columns)
        self.display.click(*place)
        return place

    def scroll_to(
        self, name: str, area: str = "VIEW_3D", region: str = "UI", window: int = 0, columns: Sequence[float] = (0.5,)
    ) -> tuple[float, float]:
        """Where that button is, once it is in view."""
        left, top, _width, height = self.region(area, region, window)
        place = self.find(name, area, region, window, columns)
        if place is None:
            self.display.scroll(left + MARGIN_PIXELS, top + height / 2, -60)
        for _ in range(PAGES):
            if place is not None:
                return place
            place = self.find(name, area, region, window, columns)
            if place is None:
                self.display.scroll(left + MARGIN_PIXELS, top + height / 2, PAGE_NOTCHES)
                self._last_y = 0
        raise AssertionError(f"no button {name} in {area}, {region}")

    def menu(self, x: float, y: float) -> tuple[int, int, int, int]:
        """Open the menu at a point; its rectangle (left, top, right, bottom). A click that came while Blender was
        busy is repeated, as a person would."""
        for _ in range(3):
            before = self.display.still()
            self.display.click(x, y)
            box = self.display.appeared(before)
            if box is not None:
                return box
        raise AssertionError(f"no menu opened at {x:.0f}, {y:.0f}")

    def choose(self, x: float, y: float, row: int) -> None:
        """Open the menu at a point and click an entry: 0 is the first, -1 the last. Separators do not count where
        counting begins on the side of the menu that has none."""
        left, top, right, bottom = self.menu(x, y)
        at = top + 14 + 20 * row if row >= 0 else bottom + 4 + 20 * row
        self.display.click((left + right) / 2, at)

    def new_window(self, open_it: Callable[[], Any], title: str, box: tuple[int, int, int, int]) -> None:
        """Do what opens a window and put that at (left, top, width, height)."""
        before = self.windows()
        open_it()
        try:
            until(lambda: self.windows() > before, f"the window {title} opens", 30)
        except AssertionError:  # a click that came while Blender was busy: repeated, as a person would
            open_it()
            until(lambda: self.windows() > before, f"the window {title} opens", 30)
        self.display.place(title, *box)
        self.display.still()

    def close_newest_window(self) -> None:
        """Close the window that opened last."""
        count = self.windows()
        self.ask("close_newest_window()")
        until(lambda: self.windows() < count, "the window closes", 20)

    def type_into(self, place: tuple[float, float], text: str) -> None:
        """Replace the text of a field."""
        self.display.click(*place, times=2)
        self.display.keys("ctrl+a")
        self.display.write(text)
        self.display.keys("Return")

    def choose_file(self, path: str, before_confirming: Callable[[], None] = lambda: None) -> None:
        """Fill in and confirm the file browser in the newest window."""
        newest, count = self.windows() - 1, self.windows()
        folder, _, name = path.rpartition("/")
        self._type_folder(folder, newest)
        # The field for the name is all there is beside the two buttons, and Blender 5 does not tell its path.
        left, top, width, height = self.region("FILE_BROWSER", "EXECUTE", newest)
        self.type_into((left + 0.3 * width, top + height / 2), name)
        before_confirming()
        self._confirm(newest, count)

    def choose_folder(self, path: str, before_confirming: Callable[[], None] = lambda: None) -> None:
        """Fill in and confirm the file browser in the newest window, where it asks for a folder; that exists."""
        newest, count = self.windows() - 1, self.windows()
        self._type_folder(path, newest)
        # In Blender 5 Return took the completion of the name, and the field is still open: a click beside it ends that.
        left, top, width, height = self.region("FILE_BROWSER", "WINDOW", newest)
        self.display.click(left + 0.5 * width, top + 0.9 * height)
        before_confirming()
        self._confirm(newest, count)

    def _type_folder(self, folder: str, window: int) -> None:
        place = self.find("params.directory", "FILE_BROWSER", "UI", window, (0.4,))
        assert place is not None, "no field for the folder in the file browser"
        self.type_into(place, folder)

    def _confirm(self, window: int, count: int) -> None:
        self.press("file.execute", "FILE_BROWSER", "EXECUTE", window, (0.9,))
        until(lambda: self.windows() < count, "the file browser closes", 30)


def until(condition: Callable[[], Any], what: str, seconds: float, pause: float = 0.1) -> Any:
    """Wait for a condition and give its value.

    Raises:
        AssertionError: it did not come true in time.
    """
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(pause)
    raise AssertionError(f"{what}: not within {seconds:.0f} s")
