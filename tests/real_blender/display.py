"""An X server without a screen inside a root, its mouse and keyboard, and pictures of what it shows."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import numpy as np
from PIL import Image, ImageChops
from scipy import ndimage

from .root import Root

WIDTH, HEIGHT = 1600, 1000
DRAG_STEPS = 16
MENU_GREY = 24  # behind menus in Blender's default theme
MENU_PIXELS = 40  # a menu is higher, a button is not


class Display:
    """A running X server. Coordinates are pixels from the top left corner.

    Attributes:
        settle: waits until what was done with mouse and keys has been taken; whoever runs a program on it sets this.
    """

    def __init__(self, root: Root, log: Path) -> None:
        self.settle: Callable[[], None] = lambda: time.sleep(0.2)
        self._screen = root.home / ".screen"
        self._screen.mkdir(exist_ok=True)
        self._log = log.open("w")
        self._server = subprocess.Popen(
            root.command(
                *("Xvfb", "-displayfd", "1", "-nolisten", "tcp", "-screen", "0", f"{WIDTH}x{HEIGHT}x24"),
                *("-fbdir", f"{root.HOME}/.screen"),
            ),
            env=root.environment(),
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
        )
        assert self._server.stdout is not None
        number = self._server.stdout.readline().strip()
        assert number, f"the X server did not start: {log.read_text()}"
        self.name = f":{number}"
        # One shell inside for all xdotool calls: entering the root costs more than a click.
        self._shell = subprocess.Popen(
            root.command("bash"),
            env=root.environment(DISPLAY=self.name),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def __enter__(self) -> Display:
        return self

    def __exit__(self, _kind: type | None, _error: BaseException | None, _trace: TracebackType | None) -> None:
        for process in (self._shell, self._server):
            process.terminate()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        self._log.close()

    def _run(self, command: str) -> None:
        assert self._shell.stdin is not None and self._shell.stdout is not None
        self._shell.stdin.write(f"{command}; echo status $?\n")
        self._shell.stdin.flush()
        said = self._shell.stdout.readline().strip()
        assert said == "status 0", f"{command}: {said}"

    def move(self, x: float, y: float) -> None:
        """Put the mouse there, by two movements: one alone is no movement when it already was there."""
        self._run(f"xdotool mousemove {x + 1:.0f} {y:.0f} mousemove {x:.0f} {y:.0f}")
        self.settle()

    def click(self, x: float, y: float, times: int = 1, button: int = 1) -> None:
        """Move and click."""
        self.move(x, y)
        self._run(f"xdotool click --repeat {times} --delay 80 {button}")
        self.settle()

    def scroll(self, x: float, y: float, notches: int) -> None:
        """Turn the wheel there; positive is down."""
        self.move(x, y)
        self._run(f"xdotool click --repeat {abs(notches)} --delay 40 {5 if notches > 0 else 4}")
        self.settle()

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at ``start``, let go at ``end``."""
        self.move(*start)
        self._run("xdotool mousedown 1")
        self.settle()
        for part in np.linspace(0, 1, DRAG_STEPS + 1)[1:]:  # a button takes few long strides for a click
            x, y = start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1])
            self._run(f"xdotool mousemove {x:.0f} {y:.0f}")
            self.settle()
        self._run("xdotool mouseup 1")
        self.settle()

    def keys(self, *names: str) -> None:
        """Press keys or chords (``ctrl+a``)."""
        self._run("xdotool key --delay 60 " + " ".join(names))
        self.settle()

    def wheel_with(self, key: str, x: float, y: float, notches: int) -> None:
        """Turn the wheel there while a key is held."""
        self.move(x, y)
        button = 5 if notches > 0 else 4
        self._run(f"xdotool keydown {key} click --repeat {abs(notches)} --delay 80 {button} keyup {key}")
        self.settle()

    def write(self, text: str) -> None:
        """Type a text."""
        self._run(f"xdotool type --delay 12 -- '{text}'")
        self.settle()

    def place(self, title: str, left: int, top: int, width: int, height: int) -> None:
        """Move and resize the window of that title, as there is no window manager to do it."""
        self._run(f"xdotool search --name '{title}' windowmove {left} {top} windowsize {width} {height}")
        self.settle()

    def look(self) -> Image.Image:
        """The screen as it is now. Read from the server's memory, which it maps into a file in xwd format: a header
        of big-endian words, a table of colours of 12 bytes each, rows of blue, green, red and a byte of padding.
        Blender's own screenshot reads the front buffer, which is black under software OpenGL."""
        raw = (self._screen / "Xvfb_screen0").read_bytes()
        words = np.frombuffer(raw[:100], ">u4")
        start, row_bytes, colours = int(words[0]), int(words[12]), int(words[19])
        rows = np.frombuffer(raw, np.uint8, HEIGHT * row_bytes, start + 12 * colours).reshape(HEIGHT, row_bytes)
        return Image.fromarray(np.ascontiguousarray(rows[:, : 4 * WIDTH].reshape(HEIGHT, WIDTH, 4)[:, :, 2::-1]))

    def still(self, seconds: float = 0.5) -> Image.Image:
        """The screen once it has not changed for some time (at most five times as long is waited for it)."""
        picture, since = self.look(), time.monotonic()
        end = since + 5 * seconds + 2
        while time.monotonic() < min(since + seconds, end):
            time.sleep(0.1)
            now = self.look()
            if ImageChops.difference(picture, now).getbbox() is not None:
                picture, since = now, time.monotonic()
        return picture

    def appeared(self, before: Image.Image, seconds: float = 4.0) -> tuple[int, int, int, int] | None:
        """Rectangle (left, top, right, bottom) of the menu that opens: the largest piece that has taken the grey behind
        menus; None where there is none in time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            now, was = np.asarray(self.still(0.3), int), np.asarray(before, int)
            back = (np.abs(now - MENU_GREY) < 7).all(axis=2) & (np.abs(now - was) > 3).any(axis=2)
            labels, _count = ndimage.label(ndimage.binary_dilation(back, np.ones((9, 9))))
            sizes = [(rows.stop - rows.start, rows, columns) for rows, columns in ndimage.find_objects(labels)]
            height, rows, columns = max(sizes, key=lambda size: size[0], default=(0, slice(0), slice(0)))
            if height > MENU_PIXELS:
                return columns.start + 4, rows.start + 4, columns.stop - 4, rows.stop - 4
        return None
