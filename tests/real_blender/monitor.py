"""Inside Blender: how long the main thread was away, and how long of that it spent in the extension's own code.

Two measures. *Gaps*: a timer of 5 ms notes the time between its calls, whoever caused it: a redraw by software OpenGL
alone is 100 ms and more. *Own time*: every call that enters the extension's files from outside (a panel's draw, an
operator, a timer, a handler) is timed until it returns, Blender's functions that it calls included. Redraws happen
outside such calls, so that own time is what the extension is answerable for.
"""

from __future__ import annotations

import sys
import threading
import time

TOOL = 4  # any free id of sys.monitoring
EVENTS = sys.monitoring.events


class Monitor:
    """Attributes: gaps and calls, in seconds; calls carries the entered function's name."""

    def __init__(self, folder: str) -> None:
        self._folder, self._thread = folder, threading.get_ident()
        self._depth, self._entered = 0, 0.0
        self._last: float | None = None
        self.gaps: list[float] = []
        self.calls: list[tuple[float, str]] = []

    def start(self) -> None:
        """Begin to watch the code under the folder."""
        sys.monitoring.use_tool_id(TOOL, "iris-test")
        watched = {
            EVENTS.PY_START: self._enter,
            EVENTS.PY_RESUME: self._enter,
            EVENTS.PY_THROW: self._enter,
            EVENTS.PY_RETURN: self._leave,
            EVENTS.PY_YIELD: self._leave,
            EVENTS.PY_UNWIND: self._leave,
        }
        for event, callback in watched.items():
            sys.monitoring.register_callback(TOOL, event, callback)
        sys.monitoring.set_events(TOOL, sum(watched))

    def tick(self) -> None:
        """To be called from a timer."""
        now = time.perf_counter()
        if self._last is not None:
            self.gaps.append(now - self._last)
        self._last = now

    def take(self) -> dict[str, list]:
        """Everything measured since the last time."""
        gaps, calls = self.gaps, self.calls
        self.gaps, self.calls, self._last = [], [], None
        return {"gaps": gaps, "calls": calls}

    def _outside(self, code: object) -> bool:
        return not code.co_filename.startswith(self._folder) or threading.get_ident() != self._thread

    def _enter(self, code: object, *_rest: object) -> object:
        if not code.co_filename.startswith(self._folder):
            return sys.monitoring.DISABLE if len(_rest) == 1 else None
        if threading.get_ident() == self._thread:
            if self._depth == 0:
                self._entered = time.perf_counter()
            self._depth += 1
        return None

    def _leave(self, code: object, *_rest: object) -> None:
        if self._outside(code) or self._depth == 0:
            return
        self._depth -= 1
        if self._depth == 0:
            self.calls.append((time.perf_counter() - self._entered, f"{code.co_filename}:{code.co_qualname}"))
