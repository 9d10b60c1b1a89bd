"""The solver as a process of its own, seen from Blender: start, messages, stop. Nothing here touches bpy.

The worker writes newline-delimited JSON on stdout (:func:`iris_addon.progress.json_lines`) and its errors on stderr;
threads move both into queues, so that :meth:`Worker.poll` never blocks.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from ..errors import Cancelled, IrisError

GRACE_SECONDS = 5.0
CANCELLED_CODE = 130
STDERR_LINES = 200


def solve_command(python: str, addon: Path, capture: Path, out: Path, preset: str) -> list[str]:
    """The command line of a solve that goes on where an earlier one stopped and writes nothing into the add-on's
    folder."""
    run = addon / "headless" / "run.py"
    return [python, "-B", str(run), "solve", str(capture), "--out", str(out), "--preset", preset, "--resume", "--json"]


class Worker:
    """A running command.

    Attributes:
        stage, fraction, overall, seconds_left: the latest progress (see :class:`iris_addon.progress.ProgressEvent`).

    Raises:
        IrisError: the program cannot be started.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.stage, self.fraction, self.overall = "", 0.0, 0.0
        self.seconds_left: float | None = None
        self._messages: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._errors: deque[str] = deque(maxlen=STDERR_LINES)
        # Blender's PYTHONHOME and PYTHONPATH would make another Python load Blender's library.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        environment["PYTHONUTF8"] = "1"
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                errors="replace",
                env=environment,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
        except OSError as error:
            what = f"{command[0]}: the solver cannot be started ({error.strerror})"
            raise IrisError(what, "set the solver's Python in the preferences") from error
        self._threads = [
            threading.Thread(target=self._read_messages, args=(self._process.stdout,), daemon=True),
            threading.Thread(target=self._read_errors, args=(self._process.stderr,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def running(self) -> bool:
        """Whether the process lives or has messages that were not polled."""
        return self._process.poll() is None or not self._messages.empty()

    def poll(self) -> bool:
        """Take the messages that have come; True if there were any. Never blocks."""
        news = False
        while True:
            try:
                message = self._messages.get_nowait()
            except queue.Empty:
                return news
            if message.get("type") == "progress":
                self.stage, self.fraction = message["stage"], message["fraction"]
                self.overall, self.seconds_left = message["overall"], message["seconds_left"]
                news = True

    def wait(self) -> None:
        """Block until the process has ended."""
        self._process.wait()
        self.poll()

    def interrupt(self) -> None:
        """Ask the process to stop at its next checkpoint, as Ctrl-C does."""
        if self._process.poll() is None:
            self._process.send_signal(signal.CTRL_BREAK_EVENT if sys.platform == "win32" else signal.SIGINT)

    def close(self) -> None:
        """Make sure that the process is gone: interrupted, and killed if it does not listen."""
        self.interrupt()
        try:
            self._process.wait(GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()

    def raise_if_failed(self) -> None:
        """Raise what the ended process failed with.

        Raises:
            Cancelled: it was interrupted.
            IrisError: anything else, in the process's own words where it said what was wrong.
        """
        code = self._process.returncode
        if code == 0:
            return
        if code in (CANCELLED_CODE, -signal.SIGINT):
            raise Cancelled
        said = next((line for line in reversed(self._errors) if line.startswith("error: ")), None)
        if said is not None:
            what, _, fix = said.removeprefix("error: ").partition(" — ")
            raise IrisError(what, fix or "see the system console")
        how = f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
        last = self._errors[-1] if self._errors else "no message"
        raise IrisError(f"the solver {how} ({last})", "solve again: it goes on from the last finished stage")

    def _read_messages(self, pipe: IO[str]) -> None:
        for line in pipe:
            try:
                message = json.loads(line)
            except ValueError:
                self._errors.append(line.rstrip())  # a library that prints: kept for the log, no message of ours
                continue
            if isinstance(message, dict):
                self._messages.put(message)

    def _read_errors(self, pipe: IO[str]) -> None:
        for line in pipe:
            self._errors.append(line.rstrip())
